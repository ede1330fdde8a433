"""Pages for a browser: contents as JSON and bytes, and the HTML file with them."""
