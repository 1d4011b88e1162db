"""What the benchmark of many lamps needs: its lamps, its runs, and the model of a farm."""
