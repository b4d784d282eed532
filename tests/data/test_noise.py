"""How precise measured positions are: what is declared, else what the samples show."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tepm_opt.data.noise import noise_of
from tepm_opt.errors import InputError
from tests.data.made import make_dataset


def test_what_is_declared_counts() -> None:
    assert noise_of(replace(make_dataset(3e-4), position_noise=7e-3)) == 7e-3


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_samples_show_their_noise(noise: float) -> None:
    assert noise_of(replace(make_dataset(noise), position_noise=None)) == pytest.approx(noise, rel=0.15)


def test_equilibria_do_not_show_it() -> None:
    with pytest.raises(InputError, match=r"made: position_noise_m is missing and cannot be estimated; give the tracker's noise"):
        noise_of(replace(make_dataset(), position_noise=None, static=True))
