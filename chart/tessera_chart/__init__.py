"""Charts of accuracy against time: renders scenes, applies every filter, measures, draws."""
