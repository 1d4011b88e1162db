"""What tests share: lamps, assets, receivers, damaged files."""
