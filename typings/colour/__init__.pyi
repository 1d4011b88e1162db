"""What lumitree uses of colour-science (the package is optional)."""

from typing import Any

from . import quality as quality

class SpectralDistribution:
    def __init__(self, data: Any) -> None: ...

def colour_rendering_index(sd_test: SpectralDistribution, additional_data: bool = ...) -> Any: ...
