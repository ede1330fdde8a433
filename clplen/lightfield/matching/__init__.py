"""Views compared with the centre view on planes of disparity: samples in, costs and planes out."""
