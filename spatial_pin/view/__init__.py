"""Showing a mechanism: in the browser, as a page, a picture, a film, plots, a report.

Nothing here imports meshcat or matplotlib before it is used.
"""

from spatial_pin.view.browser import screenshot
from spatial_pin.view.html import export_html
from spatial_pin.view.live import live
from spatial_pin.view.look import Look
from spatial_pin.view.movie import movie
from spatial_pin.view.plots import plot
from spatial_pin.view.report import report
from spatial_pin.view.server import Viewer, show

__all__ = [
    "Look",
    "Viewer",
    "export_html",
    "live",
    "movie",
    "plot",
    "report",
    "screenshot",
    "show",
]
