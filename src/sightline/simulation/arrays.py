"""Names of array types that many functions of the simulator share."""

import numpy as np
from jaxtyping import Float, Float32, Float64, Int32

RayVectors = Float32[np.ndarray, "num_rays 3"]
RayValues = Float32[np.ndarray, " num_rays"]
RayRows = Int32[np.ndarray, " num_rays"]
Numbers = Float[np.ndarray, "..."]  # of any shape
Shaped = Float64[np.ndarray, "*shape"]  # of one shape within a function
Values = Float64[np.ndarray, " count"]
AnyValues = Float[np.ndarray, " count"]
Points = Float64[np.ndarray, "count 3"]
AnyPoints = Float[np.ndarray, "count 3"]
Vector3 = Float64[np.ndarray, "3"]
Columns = Float64[np.ndarray, " columns"]
Bones = Float64[np.ndarray, "num_bones 3 4"]  # a rigid motion [R | t] of each bone
