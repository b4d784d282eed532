"""Model selection: screening, fits, cross-validation, forward selection and backward elimination."""
