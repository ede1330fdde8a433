"""Depth of a light field on a device: the cues, depth maps, all-in-focus pictures, alpha of one
object. What comes in is a `LightField` or a `FocalStack`; what leaves is a `DepthMap`, an
`AlphaEstimate` or an `Image`, and what each cue needs of memory."""
