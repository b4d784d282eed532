"""The contract of a rig."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Rig
from tepm_opt.models.layout import Layout


class RigContract:
    """Subclass it in a test file, give `open_rig`, and pytest runs what every rig has to keep.

    The rig may move: it gets a tenth of its largest inputs for a fraction of a second.
    """

    def open_rig(self) -> Rig:
        """A rig that nobody has used yet."""
        raise NotImplementedError

    def _small(self, rig: Rig) -> Command:
        return Command.from_inputs(0.1 * rig.robot.input_max)

    def test_samples_have_the_shapes_of_the_robot(self) -> None:
        """Points of the robot, gauges of its actuators or none; times that rise and are not ahead of the rig's."""
        with self.open_rig() as rig:
            layout, before = Layout.from_robot(rig.robot), -np.inf
            rig.apply(self._small(rig))
            for _ in range(10):
                sample = rig.read()
                assert sample.points.shape == (layout.points, 3)
                for measured in (sample.pressures, sample.tensions):
                    assert measured is None or measured.shape == (layout.inputs // 2,)
                assert before < sample.time <= rig.time + 1e-9
                before = sample.time
                rig.apply(self._small(rig))

    def test_what_is_outside_the_limits_is_refused(self) -> None:
        """NaN, too much, less than nothing, a wrong number of set points: an error that tells what is valid; the rig goes on."""
        with self.open_rig() as rig:
            good, most = self._small(rig), rig.robot.input_max
            for wrong in (np.nan, 1.01 * most[0], -0.01 * most[0]):
                inputs = np.concatenate([good.pressures, good.tensions])
                inputs[0] = wrong
                _refuses(rig, Command.from_inputs(inputs))
            _refuses(rig, Command.from_inputs(np.zeros(len(most) + 2)))
            rig.apply(good)
            rig.read()

    def test_stopping_twice_does_no_harm(self) -> None:
        """Leaving the rig after it was stopped, too."""
        with self.open_rig() as rig:
            rig.apply(self._small(rig))
            rig.read()
            rig.stop()
            rig.stop()

    def test_it_stops_when_it_is_left_by_an_error(self) -> None:
        """The error goes on to whoever called, and the rig was stopped."""
        rig, stopped = self.open_rig(), list[bool]()
        stop = rig.stop
        rig.stop = lambda: stopped.append(True) or stop()  # type: ignore[method-assign]
        with pytest.raises(KeyError, match="whoever called"):
            self._fail_inside(rig)
        assert stopped

    def _fail_inside(self, rig: Rig) -> None:
        with rig:
            rig.apply(self._small(rig))
            raise KeyError("whoever called")


def _refuses(rig: Rig, command: Command) -> None:
    """Check that a command is refused with what is valid."""
    with pytest.raises(InputError, match=r"valid|limit"):
        rig.apply(command)
