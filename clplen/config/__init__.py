"""Camera files: build cameras, scenes, light and sensors in SI units from TOML files."""
