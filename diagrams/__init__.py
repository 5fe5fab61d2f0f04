"""Scripts, from the folder above: python -m diagrams.examples.run_scenario --quick."""
