"""The committed charts of docs/: what regenerate_charts.py makes."""
