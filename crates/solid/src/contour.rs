//! Contours of things, seen by a ranging sensor of uncertain pose.
