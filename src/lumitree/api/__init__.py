"""The functions of `lumitree`: typed arguments, frozen results."""
