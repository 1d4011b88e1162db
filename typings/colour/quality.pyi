"""What lumitree uses of colour.quality."""

from typing import Any

def colour_fidelity_index_ANSIIESTM3018(sd_test: Any, additional_data: bool = ...) -> Any: ...
