"""What the benchmark of light inside a lamp's box needs: patches, their irradiance, a desk."""
