"""The NeRF-SH network: model, volume rendering, losses and training.

The coarse and the fine network take positions only. The rays of all views form one set. A step is a
pure function of the state and the step number, so a resumed run gives the same bits. All devices
share the rays of a batch (`devices`). Samples are placed only within the visual hull of the opacity
masks, along the *occupied length* of a ray; the widths of intervals remain true lengths.
"""
