"""Noise of measured positions."""

from __future__ import annotations

import numpy as np

from tepm_opt.data.checks.findings import Subject
from tepm_opt.data.datasets import DataSet
from tepm_opt.errors import InputError


def noise_of(dataset: DataSet) -> float:
    """Noise of a coordinate, 1 sigma in m: what the data set declares, else what the samples' second differences show.

    Raises:
        InputError: it declares none and the samples show none (data of equilibria, or without noise).
    """
    if dataset.position_noise:
        return dataset.position_noise
    levels = [Subject(run, dataset.channels, dataset.sample_rate).noise for run in dataset.runs if not dataset.static]
    seen = [float(np.nanmedian(level)) for level in levels if np.isfinite(level).any()]
    if not seen or not max(seen) > 0:
        raise InputError(
            f"{dataset.name}: position_noise_m is missing and cannot be estimated; give the tracker's noise, 1 sigma per axis in m"
        )
    return float(np.median(seen))
