"""A plugin of pytest: the C of the backends is compiled with the address and the undefined behaviour sanitizer (see test_sanitized)."""

from __future__ import annotations

from tepm_opt.models.backends import ccode

SANITIZED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer", "-g1", "-O1")
ccode.FLAGS = (*(flag for flag in ccode.FLAGS if flag != "-O3"), *SANITIZED)
ccode.SEGMENT_FLAGS = ccode.KERNEL_FLAGS = (*ccode.KERNEL_FLAGS, *SANITIZED)
