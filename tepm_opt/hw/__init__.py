"""Rigs: what carries out set points and is measured. Bytes, limits and time; no CasADi.

`rig` is what all of them offer, `registry` opens one by its name, `commands` are checks that every rig makes, `ramp` is the slow way from
one command to another, `replay` plays recorded runs, `trackers` bring poses. `board` is the real robot behind its control board,
`simulation` another robot in C or MuJoCo; neither knows the other. `service` stands on `board`. `firmware` is what runs on the board.
"""

from tepm_opt.renamed import rename_modules

rename_modules(__name__, {"tracker": "trackers.frames", "igtl": "trackers.kinds.openigtlink"})
