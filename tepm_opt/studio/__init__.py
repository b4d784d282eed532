"""The studio: a robot in the browser. What it knows and draws is made without a browser; viser is a thin shell around it.

`arm` is an operating point that a person drags or sets, `words` tells it, `shapes` is what is drawn of it, `workspace` how far the tip
reaches, `recordings` are measured runs beside their models, `loop` a closed loop on a simulated rig in real time. `worker` does one
piece of work after the other, the newest only. `server` is viser behind a token, `scene` puts shapes into it, `page` is the whole page,
`live` the view of `tepm mpc --view`.

Nothing here can reach a real robot: an import contract keeps `hw.board`, `hw.service` and `hw.registry` out, however indirectly.
"""
