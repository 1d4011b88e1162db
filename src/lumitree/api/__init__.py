"""The functions of `lumitree`: typed arguments in, frozen results out."""
