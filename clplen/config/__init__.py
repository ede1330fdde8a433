"""Camera files: TOML text comes in; cameras, scenes, light and sensors in SI units leave."""
