//! Number types of binary files: sizes and decoding.

/// Type of a number in a binary file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NumberType {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl NumberType {
    /// Parses a type name of PLY, in the old (`uchar`) or the new spelling (`uint8`).
    pub(crate) fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Type from a kind (`I`, `U` or `F`) and a size in bytes, as in the `TYPE` and `SIZE` lines of PCD.
    pub(crate) fn of_kind(kind: &str, size: &str) -> Option<Self> {
        Some(match (kind, size) {
            ("I", "1") => Self::I8,
            ("U", "1") => Self::U8,
            ("I", "2") => Self::I16,
            ("U", "2") => Self::U16,
            ("I", "4") => Self::I32,
            ("U", "4") => Self::U32,
            ("I", "8") => Self::I64,
            ("U", "8") => Self::U64,
            ("F", "4") => Self::F32,
            ("F", "8") => Self::F64,
            _ => return None,
        })
    }

    /// Size in bytes.
    pub(crate) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Decodes a number; `BIG` selects big endian. Integers of eight bytes beyond 2⁵³ lose their last digits.
    ///
    /// The byte order is a constant parameter, so that the inner loop of a reader has no branch on it.
    #[inline]
    pub(crate) fn decode<const BIG: bool>(self, bytes: &[u8]) -> f64 {
        fn ordered<const BIG: bool, const N: usize>(bytes: &[u8]) -> [u8; N] {
            let mut ordered = [0; N];
            // Callers pass at least `N` bytes. A shorter slice is an error of the program, not of a file.
            ordered.copy_from_slice(&bytes[..N]);
            if BIG {
                ordered.reverse();
            }
            ordered
        }
        match self {
            Self::I8 => f64::from(i8::from_le_bytes(ordered::<BIG, 1>(bytes))),
            Self::U8 => f64::from(bytes[0]),
            Self::I16 => f64::from(i16::from_le_bytes(ordered::<BIG, 2>(bytes))),
            Self::U16 => f64::from(u16::from_le_bytes(ordered::<BIG, 2>(bytes))),
            Self::I32 => f64::from(i32::from_le_bytes(ordered::<BIG, 4>(bytes))),
            Self::U32 => f64::from(u32::from_le_bytes(ordered::<BIG, 4>(bytes))),
            Self::I64 => i64::from_le_bytes(ordered::<BIG, 8>(bytes)) as f64,
            Self::U64 => u64::from_le_bytes(ordered::<BIG, 8>(bytes)) as f64,
            Self::F32 => f64::from(f32::from_le_bytes(ordered::<BIG, 4>(bytes))),
            Self::F64 => f64::from_le_bytes(ordered::<BIG, 8>(bytes)),
        }
    }
}
