//! planish
