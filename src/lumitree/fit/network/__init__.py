"""The NeRF-SH network: model, volume rendering, losses and training."""
