"""What lumitree uses of eulumdat-ugr (the package is optional)."""

from typing import Any

class UgrCalculator:
    @classmethod
    def compute(cls, ldt: Any) -> Any: ...
