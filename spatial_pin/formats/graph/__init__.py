"""Joint graphs, as SDFormat, USD and URDFs with loops state them, to open trees and closures."""

from spatial_pin.formats.graph.joint_graph import WORLD, GraphJoint, JointGraph, Link, SpanningTree
from spatial_pin.formats.graph.open_tree import open_tree

__all__ = ["WORLD", "GraphJoint", "JointGraph", "Link", "SpanningTree", "open_tree"]
