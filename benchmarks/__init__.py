"""Measurements of accuracy, speed and memory; every one states what it compares with.

Linear algebra runs on one thread, as the matrices are small and times are compared.
"""

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
