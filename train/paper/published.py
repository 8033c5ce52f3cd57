"""The numbers that the paper prints (arXiv 2602.18886, tables 1 to 6), on its authors' own objects and simulations.

They stand beside this project's for orientation; no row can be compared with a row of another data set. Errors of E are
taken as decades.
"""

from __future__ import annotations

from dataclasses import dataclass

OBJECTS = (
    "backpack", "bell", "blocks", "bus", "cream", "elephant", "grandpa", "leather", "lion", "mario", "sofa", "turtle",
)  # fmt: skip
LOG10_ERRORS = (0.32, 0.34, 0.10, 0.28, 0.34, 0.60, 0.97, 0.18, 0.23, 0.54, 0.01, 0.56)
POISSON_ERRORS = (0.06, 0.09, 0.02, 0.02, 0.05, 0.08, 0.03, 0.02, 0.03, 0.12, 0.02, 0.01)
OBSERVED_PSNR = (28.09, 29.67, 32.65, 27.97, 34.62, 29.17, 27.67, 33.50, 27.58, 27.46, 30.15, 31.49)


@dataclass(frozen=True)
class PublishedMeans:
    """Means over the paper's objects; None where it prints none.

    Attributes:
        observed, future: PSNR [dB], SSIM, FovVideoVDP [JOD].
        log10_error, poisson_error: mean absolute errors of E [decades] and ν.
        primitives: their number.
        minutes: of training on an NVIDIA RTX A6000.
    """

    observed: tuple[float, float, float]
    future: tuple[float, float, float]
    log10_error: float | None
    poisson_error: float | None
    primitives: int | None
    minutes: float | None


METHODS = {
    "PhysConvex": PublishedMeans((30.00, 0.962, 8.247), (25.71, 0.948, 7.683), 0.37, 0.04, 23681, 6.0),
    "Vid2Sim": PublishedMeans((28.57, 0.952, 7.794), (25.07, 0.945, 7.770), 0.51, 0.06, 31363, 8.0),
    "GIC": PublishedMeans((21.01, 0.934, 6.544), (19.20, 0.916, 5.702), 2.01, 0.16, None, 69.0),
    "PAC-NeRF": PublishedMeans((22.06, 0.924, 6.674), (20.11, 0.913, 5.948), 2.50, 0.21, None, 51.0),
    "Spring-Gaus": PublishedMeans((20.91, 0.920, 6.410), (18.32, 0.905, 5.443), None, None, 22882, 32.0),
}
ABLATION = {  # by (K, M)
    (3, 10): PublishedMeans((24.90, 0.939, 6.957), (19.63, 0.919, 6.139), 0.74, 0.05, 11827, 5.33),
    (4, 8): PublishedMeans((29.47, 0.959, 8.152), (24.55, 0.944, 7.605), 0.351, 0.053, 14392, None),
    (4, 10): PublishedMeans((29.56, 0.960, 8.151), (24.50, 0.944, 7.500), 0.376, 0.044, 14405, 5.60),
    (4, 12): PublishedMeans((29.60, 0.960, 8.206), (24.47, 0.943, 7.558), 0.510, 0.043, 14180, None),
    (5, 10): PublishedMeans((29.88, 0.961, 8.235), (25.09, 0.946, 7.688), 0.36, 0.04, 18773, 6.08),
    (6, 8): PublishedMeans((29.96, 0.962, 8.214), (25.05, 0.946, 7.635), 0.330, 0.048, 23832, None),
    (6, 10): PublishedMeans((30.00, 0.962, 8.247), (25.71, 0.948, 7.683), 0.371, 0.044, 23681, 6.23),
    (6, 12): PublishedMeans((29.88, 0.961, 8.210), (24.76, 0.944, 7.601), 0.321, 0.048, 23736, None),
    (7, 10): PublishedMeans((30.01, 0.962, 8.235), (24.95, 0.945, 7.664), 0.38, 0.05, 29646, 6.65),
    (8, 10): PublishedMeans((30.19, 0.962, 8.290), (25.38, 0.948, 7.760), 0.47, 0.04, 35320, 7.08),
}
