"""Parts of the benchmark of light inside a lamp's box: patches, their irradiance, a desk."""
