"""Models as files for simulators: what a format holds of a model, and how it is written."""
