"""The real robot: `ports` and `protocol`, the conversation with its control board (`link`, `linklog`), `calibration`, the `rig` on them."""
