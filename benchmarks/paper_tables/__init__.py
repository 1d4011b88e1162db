"""The cells of `python -m benchmarks paper`, what they share, and the page that shows them."""
