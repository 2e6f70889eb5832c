"""The operators of the textbooks: finite displacements in the plane and in space, and back.

Sources cited in this package:

- [Chasles1830] M. Chasles, Bulletin des sciences mathematiques 14, 321-326, 1830.
- [Craig2005] J. J. Craig, Introduction to Robotics: Mechanics and Control, 3rd ed., 2005.
- [EMT2431] W. Nyaga, Spatial Mechanisms, lecture notes EMT 2431.
- [Pham] V.-S. Pham, L. Nguyen, A Novel Method for Spatial Structural Kinematic Analysis.
- [Shepperd1978] S. W. Shepperd, Quaternion from rotation matrix, J. Guidance and Control 1, 1978.
- [Umeyama1991] S. Umeyama, Least-squares estimation of transformation parameters between two point
  patterns, IEEE Trans. PAMI 13, 1991.
"""

from spatial_pin.operators.angular import (
    body_angular_acceleration,
    body_angular_velocity,
    spatial_angular_acceleration,
    spatial_angular_velocity,
)
from spatial_pin.operators.dh import (
    DH_JOINTS,
    DHRow,
    DirectionCosines,
    dh_direction_cosines,
    dh_link_placements,
    dh_placement,
    model_from_dh,
)
from spatial_pin.operators.elementary import (
    ELEMENTARY_MATRICES,
    EulerAngles,
    cylindrical_placement,
    elementary_matrix,
    euler_zxz_from_rotation,
    planar_placement,
    prismatic_placement,
    revolute_placement,
    screw_placement,
    spherical_placement,
    universal_placement,
)
from spatial_pin.operators.planar import (
    complex_rotation,
    complex_rotation_between,
    concatenated,
    displaced_planar,
    planar_motion_from_points,
    planar_rotation,
    planar_rotation_about,
    planar_rotation_matrix,
    planar_translation,
    rotation_angle,
    rotation_center,
    spatial_from_planar,
)
from spatial_pin.operators.rotation import (
    AxisAngle,
    Turn,
    axis_angle_from_rotation,
    axis_vector,
    composite_rotation,
    direction_between,
    nearest_rotation,
    rotation_matrix,
)
from spatial_pin.operators.screw import (
    ScrewDisplacement,
    as_placement,
    displaced_frame,
    displaced_points,
    helical_displacement,
    screw_displacement,
    screw_from_placement,
)

# what `spatial-pin list` shows: module, what is in it, where it comes from
OPERATORS = {
    "planar": ("Finite rotations and translations in the plane", "EMT 2431 lecture notes, 2"),
    "rotation": ("Rotation about any axis and back, composite rotations",
                 "EMT 2431 lecture notes, 3; Rodrigues 1840"),
    "screw": ("Screw displacement about any axis, and back",
              "EMT 2431 lecture notes, 4; Chasles 1830"),
    "elementary": ("Seven elementary matrices, joints and links made of them",
                   "EMT 2431 lecture notes, 5"),
    "dh": ("Denavit-Hartenberg table to a Pinocchio model",
           "A Novel Method for Spatial Structural Kinematic Analysis, section 1.3; Craig 2005"),
    "angular": ("Angular velocity and acceleration from direction cosines",
                "A Novel Method for Spatial Structural Kinematic Analysis, section 1.3"),
}

__all__ = [
    "DH_JOINTS",
    "ELEMENTARY_MATRICES",
    "OPERATORS",
    "AxisAngle",
    "DHRow",
    "DirectionCosines",
    "EulerAngles",
    "ScrewDisplacement",
    "Turn",
    "as_placement",
    "axis_angle_from_rotation",
    "axis_vector",
    "body_angular_acceleration",
    "body_angular_velocity",
    "complex_rotation",
    "complex_rotation_between",
    "composite_rotation",
    "concatenated",
    "cylindrical_placement",
    "dh_direction_cosines",
    "dh_link_placements",
    "dh_placement",
    "direction_between",
    "displaced_frame",
    "displaced_planar",
    "displaced_points",
    "elementary_matrix",
    "euler_zxz_from_rotation",
    "helical_displacement",
    "model_from_dh",
    "nearest_rotation",
    "planar_motion_from_points",
    "planar_placement",
    "planar_rotation",
    "planar_rotation_about",
    "planar_rotation_matrix",
    "planar_translation",
    "prismatic_placement",
    "revolute_placement",
    "rotation_angle",
    "rotation_center",
    "rotation_matrix",
    "screw_displacement",
    "screw_from_placement",
    "screw_placement",
    "spatial_angular_acceleration",
    "spatial_angular_velocity",
    "spatial_from_planar",
    "spherical_placement",
    "universal_placement",
]
