"""Logs whose columns are not what their names say, by formulas of their own."""
