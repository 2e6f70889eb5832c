"""Joint graphs, as SDFormat, USD and URDFs with loops state them, to open trees and closures."""

from spatial_pin.formats.graph.joints import WORLD, Joint, JointGraph, Link
from spatial_pin.formats.graph.open_tree import open_tree
from spatial_pin.formats.graph.spanning import SpanningTree, span

__all__ = ["WORLD", "Joint", "JointGraph", "Link", "SpanningTree", "open_tree", "span"]
