"""Random machined parts and their drawings, for `sheets.py` and `sheet_solids.py`."""
