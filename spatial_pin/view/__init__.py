"""Showing a mechanism: in the browser, as a page, a picture, a film, plots, a report.

Nothing here imports meshcat or matplotlib before it is used.
"""

from spatial_pin.view.page.html import export_html
from spatial_pin.view.page.live import live
from spatial_pin.view.page.plots import plot
from spatial_pin.view.page.report_page import report
from spatial_pin.view.page.server import Viewer, show
from spatial_pin.view.pictures import movie, screenshot
from spatial_pin.view.scene.look import Look

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
