"""Recipes that ship with the trainer, one TOML file each. ``training.fitting.recipe`` reads them."""
