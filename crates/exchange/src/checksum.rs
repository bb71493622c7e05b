//! Checksums of files. Reports list them, so that a reader can check which version of a file was used.

use planish_estimate::{Error, Result};
use sha2::{Digest, Sha256};
use std::fmt::Write;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Computes the SHA-256 of a file in hexadecimal digits, as `sha256sum` prints it (FIPS 180-4).
///
/// # Errors
/// `Io` if the file cannot be read.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("abc");
/// std::fs::write(&path, "abc")?;
/// assert!(planish_exchange::sha256_of(&path)?.starts_with("ba7816bf8f01cfea"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn sha256_of(path: &Path) -> Result<String> {
    let failed = |e| Error::io(format!("{}: could not be read", path.display())).with_source(e);
    let mut file = File::open(path).map_err(failed)?;
    let mut sum = Sha256::new();
    // Read in pieces, because scans may be larger than the memory.
    let mut piece = vec![0; 1 << 18];
    loop {
        match file.read(&mut piece).map_err(failed)? {
            0 => break,
            n => sum.update(&piece[..n]),
        }
    }
    Ok(hexadecimal(&sum.finalize()))
}

/// Two digits for each byte.
pub(crate) fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut digits, byte| {
        // Writing to a string cannot fail.
        let _ = write!(digits, "{byte:02x}");
        digits
    })
}
