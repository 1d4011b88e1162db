"""The exitant light field: what a luminaire sends to receivers outside its box, by light paths."""
