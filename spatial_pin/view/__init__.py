"""Showing a mechanism: in the browser, as one self-contained page, as a picture, as plots.

Nothing here imports meshcat or matplotlib before it is used.
"""

from spatial_pin.view.browser import screenshot
from spatial_pin.view.html import export_html
from spatial_pin.view.plots import plot
from spatial_pin.view.server import Viewer, show

__all__ = ["Viewer", "export_html", "plot", "screenshot", "show"]
