"""Joint graphs, as SDFormat, USD and URDFs with loops state them, to open trees and closures."""
