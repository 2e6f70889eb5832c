"""Pages: the viewer, sliders, plots and reports."""
