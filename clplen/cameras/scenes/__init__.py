"""What a camera looks at: descriptions in metres or disparities come in, sources and views go out."""
