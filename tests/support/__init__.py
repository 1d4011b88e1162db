"""Code that tests share: lamps, assets, receivers, damaged files."""
