"""Pages for a browser: what they show as JSON and bytes, and the HTML file that holds it."""
