//! Writes several files as one set: all of them appear, or none.
//!
//! **Input.** A function that writes files with [`write_atomically`](crate::write_atomically) and its
//! relatives.
//!
//! **Output.** Within [`write_as_set`], every finished file keeps its temporary name. When the function has
//! succeeded, a manifest records all renames, and the files are renamed. An error, an interruption or a panic
//! before the manifest leaves the old files.
//!
//! A process may be killed at any moment. The manifest is the commit point: [`recover`] completes the renames
//! of a manifest whose writer is gone, and removes temporary files without a manifest. A writer holds locks
//! on its temporary files and manifests, which the system releases when the process ends.
//!
//! **Limits.** The set belongs to the thread that calls [`write_as_set`]; files of other threads are
//! published at once. On file systems without locks nothing is recovered. Devices and pipes are written at
//! once.

use crate::checksum::hexadecimal;
use planish_core::{Error, Result};
use sha2::{Digest, Sha256};
use std::cell::RefCell;
use std::collections::HashSet;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex};
use tempfile::{NamedTempFile, TempDir, TempPath};

/// Start of the names of temporary files and manifests.
const PREFIX: &str = ".planish-";
/// End of the names of temporary files and folders.
const TEMPORARY: &str = ".part";
/// End of the name of a manifest.
const MANIFEST: &str = ".set";
/// First bytes of a manifest.
const MAGIC: &[u8] = b"planish output set 1\n";

thread_local! {
    /// The set of this thread while [`write_as_set`] runs.
    static OPEN: RefCell<Option<OutputSet>> = const { RefCell::new(None) };
}

/// Folders in which this process has looked for leftovers.
static RECOVERED: LazyLock<Mutex<HashSet<PathBuf>>> = LazyLock::new(Mutex::default);

/// Finished files under temporary names, and folders made for them.
#[derive(Default)]
struct OutputSet {
    staged: Vec<Staged>,
    folders: Vec<PathBuf>,
}

impl Drop for OutputSet {
    fn drop(&mut self) {
        // Folders that the failed work has made and that are empty again. The files must go first.
        self.staged.clear();
        for folder in self.folders.iter().rev() {
            let _ = fs::remove_dir(folder);
        }
    }
}

/// A file or folder that is complete under a temporary name.
pub(crate) struct Staged {
    content: Content,
    target: PathBuf,
    /// Its final path as the user wrote it: relative, and not resolved if it is a link.
    name: PathBuf,
}

/// Removed when dropped, unless it was renamed.
enum Content {
    File(NamedTempFile),
    Folder(TempDir, Option<File>),
}

impl Staged {
    /// Its present path.
    fn temporary(&self) -> &Path {
        match &self.content {
            Content::File(file) => file.path(),
            Content::Folder(folder, _) => folder.path(),
        }
    }

    /// Renames it to its final name. After a failure, the temporary file stays, and the error has its path.
    fn publish(self) -> std::result::Result<(), (PathBuf, io::Error)> {
        // The lock has to outlive the rename, or another process could take the file for a leftover.
        let (temporary, _lock) = match self.content {
            Content::File(file) => {
                let (lock, path) = file.into_parts();
                (path.keep().map_err(|e| (e.path.to_path_buf(), e.error))?, Some(lock))
            }
            Content::Folder(folder, lock) => (folder.keep(), lock),
        };
        replace(&temporary, &self.target).map_err(|e| (temporary, e))
    }
}

/// Renames a file over an older one, or a folder over an empty one.
fn replace(temporary: &Path, target: &Path) -> io::Result<()> {
    if temporary.is_dir() && target.is_dir() {
        fs::remove_dir(target)?;
    }
    fs::rename(temporary, target)
}

/// Runs `work` and publishes the files that it writes together. Within another set, the files belong to that.
///
/// # Errors
/// Those of `work`, after which no file has changed; [`Io`](planish_core::ErrorKind::Io) if the files cannot
/// be published. If a rename fails, the manifest stays, and the next run in that folder completes the set.
///
/// # Examples
/// ```
/// use planish_core::Error;
/// use planish_exchange::{write_as_set, write_atomically};
/// use std::io::Write;
/// # let folder = tempfile::tempdir().unwrap();
/// let [mesh, report] = ["part.ply", "report.html"].map(|name| folder.path().join(name));
/// let failed: Result<(), Error> = write_as_set(|| {
///     write_atomically(&mesh, |writer| writeln!(writer, "mesh"))?;
///     Err(Error::input("no report"))
/// });
/// assert!(failed.is_err() && !mesh.exists());
/// write_as_set(|| {
///     write_atomically(&mesh, |writer| writeln!(writer, "mesh"))?;
///     write_atomically(&report, |writer| writeln!(writer, "report"))
/// })?;
/// assert!(mesh.exists() && report.exists());
/// # Ok::<(), Error>(())
/// ```
pub fn write_as_set<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    if OPEN.with_borrow(Option::is_some) {
        return work();
    }
    let scope = Scope::open();
    let value = work()?;
    scope.commit()?;
    Ok(value)
}

/// Closes the set of this thread, also when the work panics.
struct Scope;

impl Scope {
    fn open() -> Self {
        OPEN.set(Some(OutputSet::default()));
        Self
    }

    fn commit(self) -> Result<()> {
        let Some(mut set) = OPEN.take() else { return Ok(()) };
        let staged = std::mem::take(&mut set.staged);
        publish(staged)?;
        // The folders have files now.
        set.folders.clear();
        Ok(())
    }
}

impl Drop for Scope {
    fn drop(&mut self) {
        drop(OPEN.take());
    }
}

/// Adds a finished file to the set of this thread, or publishes it at once without one.
pub(crate) fn stage_file(file: NamedTempFile, target: PathBuf, name: PathBuf) -> Result<()> {
    stage(Staged { content: Content::File(file), target, name })
}

/// Adds a finished folder to the set of this thread, or publishes it at once without one.
pub(crate) fn stage_folder(folder: TempDir, lock: Option<File>, target: PathBuf) -> Result<()> {
    stage(Staged { content: Content::Folder(folder, lock), name: target.clone(), target })
}

fn stage(staged: Staged) -> Result<()> {
    let staged = OPEN.with_borrow_mut(|open| match open {
        Some(set) => {
            // The later of two files with one name wins, as it does without a set.
            set.staged.retain(|earlier| earlier.target != staged.target);
            set.staged.push(staged);
            None
        }
        None => Some(staged),
    });
    staged.map_or(Ok(()), |staged| publish(vec![staged]))
}

/// Remembers a folder that was made for outputs, to be removed if the set fails.
pub(crate) fn remember_folder(folder: PathBuf) {
    OPEN.with_borrow_mut(|open| {
        if let Some(set) = open {
            set.folders.push(folder);
        }
    });
}

/// Publishes finished files. One rename is atomic by itself; several need a manifest.
fn publish(staged: Vec<Staged>) -> Result<()> {
    let folders: Vec<PathBuf> = {
        let mut seen = HashSet::new();
        staged.iter().map(|s| folder_of(&s.target)).filter(|f| seen.insert(f.clone())).collect()
    };
    let mut manifests = match staged.len() {
        0 | 1 => Vec::new(),
        _ => write_manifests(&staged, &folders)?,
    };
    let mut published = Vec::with_capacity(staged.len());
    let mut failure = None;
    for item in staged {
        let name = item.name.clone();
        match item.publish() {
            Ok(()) => published.push(name),
            Err((temporary, e)) => {
                // As long as all files are old, the set can be withdrawn. The record goes first: without it,
                // the temporary files are leftovers.
                if published.is_empty() && failure.is_none() && withdraw(&mut manifests) {
                    // A file or a folder; the other call fails.
                    let _ = fs::remove_file(&temporary).or_else(|_| fs::remove_dir_all(&temporary));
                    return Err(could_not_write(&name, e));
                }
                // Continues: the set is committed, and each rename that succeeds is one less to recover.
                failure.get_or_insert((name, e));
            }
        }
    }
    for folder in &folders {
        sync_folder(folder);
    }
    if let Some((name, e)) = failure {
        // The manifests stay, but their locks go, so that a later run can complete the set.
        for (path, _) in manifests {
            let _ = path.keep();
        }
        let message = format!(
            "{}: could not be replaced; the next command that reads or writes a file in {} completes the \
             outputs",
            name.display(),
            folder_of(&name).display()
        );
        return Err(Error::io(message).with_source(e).with_outputs(published));
    }
    // The commit record goes first: pointers to a missing record mean that nothing is left to do.
    for (path, _) in manifests {
        let _ = path.close();
    }
    Ok(())
}

/// Error of an output; a full disk is named as such.
pub(crate) fn could_not_write(path: &Path, e: io::Error) -> Error {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    let full = match e.kind() {
        StorageFull | QuotaExceeded | FileTooLarge => ": no space is left; free space or choose another disk",
        _ => "",
    };
    Error::io(format!("{}: could not be written{full}", path.display())).with_source(e)
}

/// Removes the record of a set, and then the pointers to it. Returns false if the record cannot be removed.
fn withdraw(manifests: &mut Vec<(TempPath, File)>) -> bool {
    if let Some((path, _)) = manifests.first()
        && fs::remove_file(path).is_err()
    {
        return false;
    }
    manifests.clear();
    true
}

/// Writes the commit record into the first folder, and pointers to it into the others.
///
/// The pointers are written before the record, so that all folders know of a set as soon as it is committed.
/// The record is the first of the returned files.
fn write_manifests(staged: &[Staged], folders: &[PathBuf]) -> Result<Vec<(TempPath, File)>> {
    let first = &folders[0];
    let failed = |e: io::Error| {
        Error::io(format!("{}: could not record the set of outputs", first.display())).with_source(e)
    };
    let record = hidden(first, MANIFEST).map_err(failed)?;
    let record_path = absolute(record.path());
    let mut written = Vec::with_capacity(folders.len());
    for folder in &folders[1..] {
        let pointer = hidden(folder, MANIFEST).map_err(failed)?;
        let mut bytes = MAGIC.to_vec();
        push_path(&mut bytes, record_path.as_os_str());
        pointer.as_file().write_all(&bytes).and_then(|()| pointer.as_file().sync_all()).map_err(failed)?;
        sync_folder(folder);
        let (file, path) = pointer.into_parts();
        written.push((path, file));
    }
    let mut bytes = MAGIC.to_vec();
    push_path(&mut bytes, OsStr::new(""));
    for item in staged {
        push_path(&mut bytes, absolute(item.temporary()).as_os_str());
        push_path(&mut bytes, absolute(&item.target).as_os_str());
    }
    // After a power failure, a file may have its length, but not all of its content.
    let checksum = checksum(&bytes);
    push_path(&mut bytes, OsStr::new(&checksum));
    // A part of the record commits nothing.
    record.as_file().write_all(&bytes).map_err(failed)?;
    if let Err(e) = record.as_file().sync_all() {
        // The record is complete, though perhaps not on the disk. If it can neither be emptied nor removed,
        // the set is committed and the renames follow, because a later command would complete them.
        if record.as_file().set_len(0).is_ok() || fs::remove_file(record.path()).is_ok() {
            return Err(failed(e));
        }
    }
    sync_folder(first);
    let (file, path) = record.into_parts();
    written.insert(0, (path, file));
    Ok(written)
}

/// Completes or removes what killed processes have left in the folder of a file, once per process and folder.
///
/// Reading a file does this too. Call it before the first look at a folder, for example before a listing.
pub fn recover_outputs_in_folder_of(path: &Path) {
    recover(&folder_of(path));
}

/// [`recover_outputs_in_folder_of`] by the folder. Failures are ignored: a folder that may not be changed is
/// read as it is.
pub(crate) fn recover(folder: &Path) {
    let folder = absolute(folder);
    // A poisoned lock only means that another thread panicked while it added a folder.
    let new = RECOVERED.lock().unwrap_or_else(std::sync::PoisonError::into_inner).insert(folder.clone());
    if new {
        let _ = recover_now(&folder);
    }
}

fn recover_now(folder: &Path) -> io::Result<()> {
    // Temporary files are locked before manifests are listed. A process commits while it holds these locks,
    // so every manifest that names one of these files is in the list.
    let mut abandoned = Vec::new();
    for path in hidden_files(folder, TEMPORARY)? {
        if let Abandoned::Yes(lock) = abandoned_lock(&path)? {
            abandoned.push((path, lock));
        }
    }
    let mut in_use = false;
    for path in hidden_files(folder, MANIFEST)? {
        match abandoned_lock(&path)? {
            Abandoned::Yes(lock) => {
                in_use |= !recover_manifest(&path)?;
                drop(lock);
            }
            Abandoned::InUse => in_use = true,
            Abandoned::Gone => {}
        }
    }
    // Another process that completes a set does not hold the locks of its temporary files.
    for (path, lock) in abandoned.into_iter().filter(|_| !in_use) {
        // Those of a completed set have their final names.
        match path.symlink_metadata() {
            Ok(known) if known.is_dir() => fs::remove_dir_all(&path)?,
            Ok(_) => fs::remove_file(&path)?,
            Err(_) => {}
        }
        drop(lock);
    }
    sync_folder(folder);
    Ok(())
}

/// The temporary files or the manifests in a folder.
fn hidden_files(folder: &Path, suffix: &str) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.as_encoded_bytes();
        if name.starts_with(PREFIX.as_bytes()) && name.ends_with(suffix.as_bytes()) {
            found.push(entry.path());
        }
    }
    Ok(found)
}

/// Whether the writer of a file is gone.
enum Abandoned {
    /// Yes, and the lock is now held here.
    Yes(File),
    /// Another process holds the lock, or there are no locks.
    InUse,
    /// The file was renamed or removed meanwhile.
    Gone,
}

/// Locks a file whose writer is gone.
///
/// A file that cannot be examined is an error and not a leftover: it may be the manifest of a committed set.
fn abandoned_lock(path: &Path) -> io::Result<Abandoned> {
    let file = match File::open(path) {
        Ok(file) => file,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Abandoned::Gone),
        Err(e) => return Err(e),
    };
    if file.try_lock().is_err() {
        return Ok(Abandoned::InUse);
    }
    // Between opening and locking, its owner may have renamed or removed it.
    Ok(if path.try_exists()? { Abandoned::Yes(file) } else { Abandoned::Gone })
}

/// Completes the renames of a manifest and removes it. Returns false if another process is doing that.
fn recover_manifest(path: &Path) -> io::Result<bool> {
    let bytes = fs::read(path)?;
    let fields = bytes.strip_prefix(MAGIC).and_then(fields).unwrap_or_default();
    match fields.split_first() {
        Some((record, [])) => {
            let record = Path::new(record);
            match abandoned_lock(record)? {
                Abandoned::InUse => return Ok(false),
                Abandoned::Yes(lock) => {
                    recover_manifest(record)?;
                    drop(lock);
                }
                // The set was never committed, or it is complete.
                Abandoned::Gone => {}
            }
        }
        Some((_, [pairs @ .., sum])) if is_checksum(&bytes, sum) => {
            for pair in pairs.chunks_exact(2) {
                let (temporary, target) = (Path::new(&pair[0]), Path::new(&pair[1]));
                // Those that were renamed before the process ended have no temporary file.
                if temporary.symlink_metadata().is_ok() {
                    replace(temporary, target)?;
                    sync_folder(&folder_of(target));
                }
            }
        }
        // Not complete, so nothing was renamed yet.
        _ => {}
    }
    fs::remove_file(path)?;
    Ok(true)
}

/// Whether `sum` is the checksum of a manifest that ends with it.
fn is_checksum(bytes: &[u8], sum: &OsStr) -> bool {
    let sum = sum.as_encoded_bytes();
    bytes.len().checked_sub(sum.len() + 1).is_some_and(|end| checksum(&bytes[..end]).as_bytes() == sum)
}

fn checksum(bytes: &[u8]) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

/// A locked file with a hidden random name in a folder.
pub(crate) fn hidden(folder: &Path, suffix: &str) -> io::Result<NamedTempFile> {
    loop {
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX).suffix(suffix);
        #[cfg(unix)]
        {
            // Temporary files are private by default; the result gets the usual rights, limited by the umask.
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(fs::Permissions::from_mode(0o666));
        }
        let file = builder.tempfile_in(folder)?;
        // File systems without locks are written as well, but leftovers on them are not recovered.
        let _ = file.as_file().lock();
        // Before it was locked, another process may have taken it for a leftover and removed it.
        if file.path().exists() {
            return Ok(file);
        }
    }
}

/// A temporary file for an output.
pub(crate) fn temporary_file(folder: &Path) -> io::Result<NamedTempFile> {
    hidden(folder, TEMPORARY)
}

/// A temporary folder for an output, and its lock.
pub(crate) fn temporary_folder(folder: &Path) -> io::Result<(TempDir, Option<File>)> {
    loop {
        let made = tempfile::Builder::new().prefix(PREFIX).suffix(TEMPORARY).tempdir_in(folder)?;
        let lock = File::open(made.path()).ok().filter(|file| file.lock().is_ok());
        if made.path().exists() {
            return Ok((made, lock));
        }
    }
}

/// Stores the entries of a folder on the disk. Not all systems can, and the rename itself has succeeded.
fn sync_folder(folder: &Path) {
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
}

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf())
}

/// The parent folder of a path; `.` for a bare file name.
pub(crate) fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
        _ => PathBuf::from("."),
    }
}

/// Appends a path and a zero byte, which no path contains.
fn push_path(bytes: &mut Vec<u8>, path: &OsStr) {
    bytes.extend_from_slice(path.as_encoded_bytes());
    bytes.push(0);
}

/// Splits the fields of a manifest. `None` if the last one is not terminated.
fn fields(bytes: &[u8]) -> Option<Vec<OsString>> {
    let bytes = bytes.strip_suffix(&[0])?;
    bytes.split(|b| *b == 0).map(os_string).collect()
}

#[cfg(unix)]
fn os_string(bytes: &[u8]) -> Option<OsString> {
    use std::os::unix::ffi::OsStrExt;
    Some(OsStr::from_bytes(bytes).to_owned())
}

#[cfg(not(unix))]
fn os_string(bytes: &[u8]) -> Option<OsString> {
    std::str::from_utf8(bytes).ok().map(OsString::from)
}

#[cfg(test)]
mod tests;
