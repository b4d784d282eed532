"""Speed of `tepm_opt` beside peers and beside the practical limit: `python -m benchmarks`.

Peers and ours run on one core; the variables below keep BLAS and OpenMP from starting more threads than that, and have to be
set before NumPy is imported.
"""

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"
