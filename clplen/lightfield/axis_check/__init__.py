"""Whether the view axes of a light field are read in the right order. What comes in is a
`LightField`; what leaves is a `LightFieldReport`, whose sentence names the words of layout."""
