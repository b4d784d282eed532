"""Images as a camera gives them."""

from __future__ import annotations

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed (extra webcam)")


def spoiled(image: np.ndarray, random: np.random.Generator, blur_px: float = 0.7, noise: float = 3.0) -> np.ndarray:
    """An image less sharp, and with noise, as a camera gives it."""
    soft = cv2.GaussianBlur(image, (0, 0), blur_px).astype(float)
    return np.clip(soft + random.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
