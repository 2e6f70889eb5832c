"""Where a frame can get to as drivers go over a grid."""
