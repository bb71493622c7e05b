//! Writes a file completely or not at all.
//!
//! **Input.** A path and a function that writes the content.
//!
//! **Output.** The finished file at that path, or no change.
//!
//! **Limits.** Data for a device or pipe (`/dev/stdout`) is written directly and cannot be undone.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::output_set::{
    could_not_write, folder_of, recover, remember_folder, stage_file, stage_folder, temporary_file,
    temporary_folder,
};
use flate2::Compression;
use flate2::write::GzEncoder;
use planish_estimate::{Error, Result};

/// Buffered writer of a file.
pub type Writer<'a> = BufWriter<&'a File>;

/// Writes a file under a temporary name in the same folder, then renames it. Readers see the old file or the
/// complete new one. Within [`write_as_set`](crate::write_as_set), it is renamed together with the others.
///
/// On an error or a panic the temporary file is removed, and an older file of that name is unchanged. A
/// symbolic link is followed: the file that it names is replaced. The new file has the mode of the old one
/// and, if permitted, its owner. The call returns after the disk has stored the bytes (`fsync`).
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the folder is missing, the path names a folder, or writing
/// fails.
///
/// # Examples
/// ```
/// use std::io::Write;
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("note.txt");
/// planish_exchange::write_atomically(&path, |writer| writeln!(writer, "done"))?;
/// assert_eq!(std::fs::read_to_string(&path)?, "done\n");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_atomically(path: &Path, write: impl FnOnce(&mut Writer) -> io::Result<()>) -> Result<()> {
    let failed = |e: io::Error| could_not_write(path, e);
    let Target::File { target, folder } = target_of(path)? else {
        // Renaming a file over `/dev/stdout` would replace the device, so the data are written through it.
        let device = OpenOptions::new().write(true).open(path).map_err(failed)?;
        let mut writer = BufWriter::new(&device);
        return write(&mut writer).and_then(|()| writer.flush()).map_err(failed);
    };
    let temporary = temporary_file(&folder).map_err(|e| cannot_create(path, &folder, &e))?;
    let mut writer = BufWriter::with_capacity(1 << 16, temporary.as_file());
    write(&mut writer).and_then(|()| writer.flush()).map_err(failed)?;
    drop(writer);
    keep_attributes(temporary.path(), &target).map_err(failed)?;
    // Without this, a power failure after the rename could leave an empty file under the final name. It
    // follows the attributes, so that they are stored too.
    temporary.as_file().sync_all().map_err(failed)?;
    stage_file(temporary, target, path.to_path_buf())
}

/// Gives a new file the mode of the file that it replaces and, if permitted, its owner and group.
fn keep_attributes(new: &Path, old: &Path) -> io::Result<()> {
    let Ok(old) = fs::metadata(old) else { return Ok(()) };
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
        let own = fs::metadata(new)?;
        if (own.uid(), own.gid()) != (old.uid(), old.gid()) {
            // Only root may give a file away, and a group must be one of the user's: the file stays the
            // user's.
            let _ = chown(new, Some(old.uid()), Some(old.gid()));
        }
        // Without set-user-ID, set-group-ID and sticky bits, which were granted to the old content.
        fs::set_permissions(new, fs::Permissions::from_mode(old.permissions().mode() & 0o777))?;
    }
    #[cfg(not(unix))]
    fs::set_permissions(new, old.permissions())?;
    Ok(())
}

/// [`write_atomically`], compressed by gzip if the path ends with `.gz`.
///
/// The encoder stores neither file name nor time, so that the same input gives the same bytes.
pub(crate) fn write_packed(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    let packed = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
    write_atomically(path, |writer| match packed {
        false => write(writer),
        true => {
            // Writers emit a few bytes at a time; the buffer keeps each from being a call of the encoder.
            let mut encoder = BufWriter::new(GzEncoder::new(writer, Compression::default()));
            write(&mut encoder)?;
            encoder.into_inner().map_err(|e| e.into_error())?.finish().map(drop)
        }
    })
}

/// Checks whether [`write_atomically`] can write a file, before a long computation fills it.
///
/// Creates an empty temporary file in the same folder and removes it.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the folder is missing or may not be written to, or the path
/// names a folder or a write-protected file.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// assert!(planish_exchange::check_writable(&folder.path().join("part.ply")).is_ok());
/// let error = planish_exchange::check_writable(&folder.path().join("none/part.ply")).unwrap_err();
/// assert!(error.to_string().contains("does not exist"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn check_writable(path: &Path) -> Result<()> {
    if path.as_os_str().as_encoded_bytes().ends_with(b"/") {
        return Err(Error::io(format!(
            "{}: expected a file name, found the name of a folder",
            path.display()
        )));
    }
    // Creating a file is the test, because permission bits do not show read-only file systems or access
    // lists.
    let failed = |e: io::Error| could_not_write(path, e);
    match target_of(path)? {
        Target::File { target, folder } => {
            recover(&folder);
            // A name that is too long fails here and not after the work. A missing file is as expected.
            match fs::symlink_metadata(&target) {
                Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(failed(e)),
                _ => {}
            }
            temporary_file(&folder).map(drop).map_err(|e| cannot_create(path, &folder, &e))
        }
        Target::Device => OpenOptions::new().write(true).open(path).map(drop).map_err(failed),
    }
}

/// Resolves links and `..` of a path, also for a file that does not exist yet.
///
/// Two names of one file give the same result, which finds outputs that would overwrite an input.
#[must_use]
pub fn real_path(path: &Path) -> PathBuf {
    // A missing file cannot be resolved, but its folder can.
    fs::canonicalize(path).unwrap_or_else(|_| match (fs::canonicalize(folder_of(path)), path.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => path.to_path_buf(),
    })
}

/// Destination of a file.
enum Target {
    /// A file in a folder, links resolved.
    File { target: PathBuf, folder: PathBuf },
    /// A device or a pipe, written directly.
    Device,
}

/// Error of a temporary file that could not be created. The folder is named, because the user has never seen
/// the temporary name.
fn cannot_create(path: &Path, folder: &Path, e: &io::Error) -> Error {
    Error::io(format!("{}: cannot create a file in the folder {}", path.display(), folder.display()))
        // Only the kind is kept, because the text of the original error contains the temporary path.
        .with_source(io::Error::from(e.kind()))
}

fn target_of(path: &Path) -> Result<Target> {
    if path.is_dir() {
        return Err(Error::io(format!("{}: expected a file name, found a folder", path.display())));
    }
    if path.file_name().is_none() {
        return Err(Error::io(format!("{}: expected a file name", path.display())));
    }
    // A missing file is not an error: it is about to be created.
    match fs::metadata(path) {
        Ok(known) if !known.is_file() => return Ok(Target::Device),
        Ok(known) if known.permissions().readonly() => {
            return Err(Error::io(format!(
                "{}: the file is write-protected; choose another name or remove the protection",
                path.display()
            )));
        }
        _ => {}
    }
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    let folder = folder_of(&target);
    if !folder.is_dir() {
        return Err(Error::io(format!(
            "{}: the folder {} does not exist; create it first",
            path.display(),
            folder.display()
        )));
    }
    Ok(Target::File { target, folder })
}

/// Creates a folder and missing folders above it; an existing folder is kept.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) if permission is missing or a file of that name exists.
pub fn make_folder(path: &Path) -> Result<()> {
    if path.exists() && !path.is_dir() {
        return Err(Error::io(format!("{}: expected a folder, found a file", path.display())));
    }
    // Listed before they are made, so that a set that fails removes only folders that are new.
    let missing: Vec<&Path> =
        path.ancestors().take_while(|p| !p.as_os_str().is_empty() && !p.exists()).collect();
    fs::create_dir_all(path)
        .map_err(|e| Error::io(format!("{}: could not be created", path.display())).with_source(e))?;
    missing.iter().rev().for_each(|folder| remember_folder(folder.to_path_buf()));
    Ok(())
}

/// A folder of files that appears complete or not at all.
///
/// It is filled under a temporary name and renamed by [`PendingFolder::finish`]. Dropped before that, it is
/// removed with its content.
///
/// # Examples
/// ```
/// use planish_exchange::PendingFolder;
/// # let place = tempfile::tempdir()?;
/// let path = place.path().join("frames");
/// let folder = PendingFolder::create(&path)?;
/// std::fs::write(folder.path().join("0.txt"), "first")?;
/// assert!(!path.exists());
/// folder.finish()?;
/// assert_eq!(std::fs::read_to_string(path.join("0.txt"))?, "first");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct PendingFolder {
    made: tempfile::TempDir,
    lock: Option<File>,
    target: PathBuf,
}

impl PendingFolder {
    /// Checks that a folder can be created at this path: nothing exists there, or an empty folder.
    ///
    /// # Errors
    /// [`Io`](planish_estimate::ErrorKind::Io) if a file or a folder with files exists there, or no folder
    /// can be created.
    pub fn check(path: &Path) -> Result<()> {
        Self::create(path).map(drop)
    }

    /// Starts a folder for this path; folders above it are created.
    ///
    /// # Errors
    /// As for [`PendingFolder::check`].
    pub fn create(path: &Path) -> Result<Self> {
        let in_the_way = |what: &str| {
            Error::io(format!(
                "{}: expected a new or empty folder, found {what}; choose another name or move it away",
                path.display()
            ))
        };
        if path.exists() && !path.is_dir() {
            return Err(in_the_way("a file"));
        }
        // A rename replaces only an empty folder. Found now, the conflict costs no computation.
        if fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(in_the_way("a folder with files in it"));
        }
        // Without a trailing slash, which would make the folder its own parent.
        let target: PathBuf = path.components().collect();
        let folder = folder_of(&target);
        make_folder(&folder)?;
        recover(&folder);
        let (made, lock) = temporary_folder(&folder).map_err(|e| cannot_create(path, &folder, &e))?;
        Ok(Self { made, lock, target })
    }

    /// Temporary path into which files are written before [`PendingFolder::finish`].
    #[must_use]
    pub fn path(&self) -> &Path {
        self.made.path()
    }

    /// Renames the folder to its final name.
    ///
    /// # Errors
    /// [`Io`](planish_estimate::ErrorKind::Io) if a file or folder has appeared there since; the files are
    /// then removed.
    pub fn finish(self) -> Result<()> {
        let failed = |e: io::Error| could_not_write(&self.target, e);
        #[cfg(unix)]
        {
            // Temporary folders are private by default; the result gets the usual rights.
            use std::os::unix::fs::PermissionsExt;
            fs::set_permissions(self.made.path(), fs::Permissions::from_mode(0o755)).map_err(failed)?;
        }
        // The check allows an empty folder, which is replaced.
        stage_folder(self.made, self.lock, self.target)
    }
}

/// Lists the paths in a folder in alphabetical order, so that results do not depend on the file system.
///
/// # Errors
/// `Io` if the folder cannot be read.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// for name in ["b.ply", "a.ply"] {
///     std::fs::write(folder.path().join(name), "")?;
/// }
/// let paths = planish_exchange::paths_in(folder.path())?;
/// assert_eq!(paths, ["a.ply", "b.ply"].map(|name| folder.path().join(name)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn paths_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).and_then(|entries| entries.map(|e| e.map(|e| e.path())).collect());
    let mut paths: Vec<PathBuf> =
        entries.map_err(|e| Error::io(format!("{}: could not be read", folder.display())).with_source(e))?;
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_estimate::ErrorKind;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_failed_write_keeps_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        write_atomically(&path, |w| w.write_all(b"old")).unwrap();
        let e = write_atomically(&path, |w| {
            w.write_all(&[b'n'; 100_000])?;
            Err(io::Error::other("disk full"))
        })
        .unwrap_err();
        assert_eq!(e.kind(), ErrorKind::Io);
        assert!(e.to_string().contains("a.ply") && e.to_string().contains("disk full"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["a.ply"]);
    }

    #[test]
    fn a_panic_while_writing_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        let write = || write_atomically(&path, |_| panic!("a bug"));
        assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(write)).is_err());
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn a_missing_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let e = write_atomically(&folder.path().join("not/here/a.ply"), |_| Ok(())).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::Io);
        assert!(e.to_string().contains("not/here does not exist"), "{e}");
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn a_folder_is_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let e = write_atomically(folder.path(), |_| Ok(())).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::Io);
        assert!(e.to_string().contains("found a folder"), "{e}");
    }

    #[test]
    fn make_folder_reports_an_existing_file() {
        let folder = tempfile::tempdir().unwrap();
        make_folder(&folder.path().join("a/b")).unwrap();
        make_folder(&folder.path().join("a/b")).unwrap();
        fs::write(folder.path().join("c"), "").unwrap();
        let e = make_folder(&folder.path().join("c")).unwrap_err();
        assert!(
            e.kind() == ErrorKind::Io && e.to_string().contains("c: expected a folder, found a file"),
            "{e}"
        );
    }

    #[test]
    fn check_writable_finds_the_errors_of_writing_and_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        check_writable(&path).unwrap();
        assert!(names(folder.path()).is_empty());
        for (path, words) in [
            (folder.path().to_path_buf(), "found a folder"),
            (folder.path().join("no/a.ply"), "no does not exist"),
        ] {
            let e = check_writable(&path).unwrap_err();
            assert!(e.kind() == ErrorKind::Io && e.to_string().contains(words), "{e}");
        }
        fs::write(&path, "kept").unwrap();
        let mut permissions = fs::metadata(&path).unwrap().permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&path, permissions).unwrap();
        for e in [check_writable(&path), write_atomically(&path, |_| Ok(()))] {
            assert!(e.unwrap_err().to_string().contains("write-protected"));
        }
        assert_eq!(fs::read(&path).unwrap(), b"kept");
    }

    #[test]
    fn two_names_of_one_file_have_one_real_path() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("b")).unwrap();
        for name in ["new.ply", "old.ply"] {
            let (plain, round) = (folder.path().join(name), folder.path().join("b/..").join(name));
            assert_eq!(real_path(&plain), real_path(&round), "{name}");
            fs::write(folder.path().join("old.ply"), "").unwrap();
        }
        assert_ne!(real_path(&folder.path().join("x")), real_path(&folder.path().join("y")));
    }

    #[cfg(unix)]
    #[test]
    fn a_symbolic_link_is_kept_and_its_target_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("real.ply"), folder.path().join("link.ply"));
        fs::write(&file, "old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write_atomically(&link, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        write_atomically(Path::new("/dev/null"), |w| w.write_all(b"gone")).unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }

    #[test]
    fn a_folder_appears_only_when_it_is_finished() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("frames/");
        let folder = PendingFolder::create(&path).unwrap();
        fs::write(folder.path().join("a"), "a").unwrap();
        assert!(!path.exists());
        drop(folder);
        assert!(names(place.path()).is_empty());
        fs::create_dir(&path).unwrap();
        let folder = PendingFolder::create(&path).unwrap();
        fs::write(folder.path().join("a"), "a").unwrap();
        folder.finish().unwrap();
        assert_eq!((names(place.path()), names(&path)), (vec!["frames".to_owned()], vec!["a".to_owned()]));
        let e = PendingFolder::check(&path).unwrap_err();
        assert!(e.to_string().contains("files in it"), "{e}");
    }
}
