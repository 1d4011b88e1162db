"""OpenUSD: lights of UsdLux with IES profiles, meshes, and materials."""
