"""Light fields, stacks and volumes shown in a browser: pages, a local server, a notebook."""
