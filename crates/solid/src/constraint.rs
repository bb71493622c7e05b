//! What holds between the parts of a drawing.
