"""Write pushes again in the release's variants: the same pushes, raw, normalised, or both."""
