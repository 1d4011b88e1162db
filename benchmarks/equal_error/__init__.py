"""Time at equal error of a lamp and of its bake: pairs, long runs, errors and reports."""
