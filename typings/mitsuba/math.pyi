RayEpsilon: float
ShadowEpsilon: float
