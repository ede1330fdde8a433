"""Raw frames: without dark frame and hot pixels, on whole pixels a lenslet or as they are."""
