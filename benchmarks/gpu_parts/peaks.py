"""Peak speeds of matrix products, as the makers' data sheets state them, dense."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Peak:
    """Peak speed of a device.

    Attributes:
        name: what its name by the driver begins with.
        float32: TFLOP/s of ordinary float32 arithmetic.
        tf32: TFLOP/s of matrix products of float32 in the format TF32, which JAX uses by default
            for matrices of float32 where the device has it; without sparsity.
    """

    name: str
    float32: float
    tf32: float


# A longer name comes before its beginning. Source: NVIDIA's data sheets and architecture papers.
PEAKS = (
    Peak("NVIDIA H200 NVL", 60.0, 417.5),
    Peak("NVIDIA H200", 67.0, 494.7),
    Peak("NVIDIA H100 NVL", 60.0, 417.5),
    Peak("NVIDIA H100 PCIe", 51.0, 378.0),
    Peak("NVIDIA H100", 67.0, 494.7),
    Peak("NVIDIA A100", 19.5, 156.0),
    Peak("NVIDIA L40S", 91.6, 183.0),
    Peak("NVIDIA L4", 30.3, 60.0),
    Peak("NVIDIA GeForce RTX 4090", 82.6, 82.6),
    Peak("NVIDIA GeForce RTX 3090", 35.6, 35.6),
)


def peak_of(device: str) -> Peak | None:
    """Peak of a device by its name; None if it is not in the table."""
    return next((peak for peak in PEAKS if device.startswith(peak.name)), None)
