"""What a camera looks at: pictures and surfaces come in, sources and views of them go out."""
