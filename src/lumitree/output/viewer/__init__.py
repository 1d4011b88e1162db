"""The viewer: one web page that shows an asset, without a network or other files."""
