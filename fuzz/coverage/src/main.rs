//! Tests one reader or command with libFuzzer: inputs that reach new code become parents of further inputs.
//!
//! In: the variable `PLANISH_FUZZ_TARGET` (a name of the table of `planish-fuzz`), and options and a folder
//! of inputs for libFuzzer. Out: libFuzzer's report, and a file for an input that panics, hangs or takes too
//! much memory. `fuzz/coverage/run` builds it and runs all targets.
//!
//! Half of the changes are those of `planish-fuzz`, which know the words of the formats; the others are
//! libFuzzer's own, which know what the code compared its input with.

#![no_main]

use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};
use planish_fuzz::mutate::change;
use planish_fuzz::targets::{COMMANDS, FuzzTarget, TARGETS};
use planish_fuzz::valid;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

/// The tested target, its valid files and its working folder.
struct Session {
    target: &'static FuzzTarget,
    valid: Vec<Vec<u8>>,
    folder: TempDir,
}

static SESSION: LazyLock<Session> = LazyLock::new(|| {
    let name = std::env::var("PLANISH_FUZZ_TARGET").expect("PLANISH_FUZZ_TARGET names a target");
    let target = TARGETS.iter().chain(COMMANDS).find(|target| target.name == name);
    let target = target.unwrap_or_else(|| panic!("unknown target `{name}`"));
    // Millions of small files are written: a file system in memory is fastest.
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
    let folder = folder.expect("a temporary folder");
    for (name, bytes) in valid::neighbours().expect("valid files") {
        fs::write(folder.path().join(name), bytes).expect("a file");
    }
    Session { target, valid: (target.valid)().expect("valid files"), folder }
});

fuzz_target!(
    init: {
        // Valid files are the first inputs. libFuzzer reads them from its folder, the first argument.
        if let Some(corpus) = std::env::args().nth(1).filter(|word| Path::new(word).is_dir()) {
            for (k, bytes) in SESSION.valid.iter().enumerate() {
                fs::write(Path::new(&corpus).join(format!("valid-{k}")), bytes).expect("a file");
            }
        }
    },
    |bytes: &[u8]| {
        let Session { target, folder, .. } = &*SESSION;
        let mut bytes = bytes.to_vec();
        // The seed depends on the bytes only (FNV-1), so that a stored input gives the same file again.
        let seed = bytes.iter().fold(0, |h: u64, &b| h.wrapping_mul(0x100_0000_01b3) ^ u64::from(b));
        (target.repair)(&mut bytes, &mut ChaCha8Rng::seed_from_u64(seed));
        let path = folder.path().join(target.file);
        fs::write(&path, bytes).expect("a file");
        // Both acceptance and rejection are fine; panics end the process.
        let _ = (target.read)(&path);
    }
);

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mut random = ChaCha8Rng::seed_from_u64(u64::from(seed));
    if random.random() {
        return fuzzer_mutate(data, size, max_size);
    }
    let mut bytes = data[..size].to_vec();
    change(&mut bytes, &SESSION.valid, SESSION.target.words, &mut random);
    let size = bytes.len().min(max_size);
    data[..size].copy_from_slice(&bytes[..size]);
    size
});
