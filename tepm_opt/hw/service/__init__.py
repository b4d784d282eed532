"""Work on the real robot by hand: `commissioning` with its `checks`, calibration lines (`calibrate`), the base's place (`registration`),
`moves` of single actuators, and a `monitor` that never arms. All of it talks over a `line`.
"""
