use super::*;
use crate::{PendingFolder, make_folder, write_atomically};

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

fn write(path: &Path, text: &str) -> Result<()> {
    write_atomically(path, |writer| writer.write_all(text.as_bytes()))
}

#[test]
fn files_appear_together_after_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write(&path("a"), "old").unwrap();
    write_as_set(|| {
        write(&path("a"), "new")?;
        // A set within a set belongs to the outer one.
        write_as_set(|| write(&path("b"), "new"))?;
        let frames = PendingFolder::create(&path("frames"))?;
        fs::write(frames.path().join("0"), "new").unwrap();
        frames.finish()?;
        assert_eq!(fs::read(path("a")).unwrap(), b"old");
        assert!(!path("b").exists() && !path("frames").exists());
        Ok(())
    })
    .unwrap();
    assert_eq!(names(folder.path()), ["a", "b", "frames"]);
    assert_eq!(fs::read(path("a")).unwrap(), b"new");
    assert_eq!(fs::read(path("frames/0")).unwrap(), b"new");
}

#[test]
fn a_failure_or_panic_leaves_the_old_files_and_no_folder() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write(&path("a"), "old").unwrap();
    let work = |fail: fn()| {
        write_as_set(|| {
            write(&path("a"), "new")?;
            make_folder(&path("made/deeper"))?;
            write(&path("made/deeper/b"), "new")?;
            fail();
            Err::<(), _>(Error::input("stopped"))
        })
    };
    assert!(work(|| ()).is_err());
    assert!(std::panic::catch_unwind(|| work(|| panic!("a bug"))).is_err());
    assert_eq!(names(folder.path()), ["a"]);
    assert_eq!(fs::read(path("a")).unwrap(), b"old");
    // The thread has no set any more.
    write(&path("b"), "new").unwrap();
    assert!(path("b").exists());
}

/// Stages files in two folders and stops as a killed process would: after `renames` renames, with `commit`
/// only after the manifests.
fn interrupted_commit(folders: [&Path; 2], commit: bool, renames: usize) {
    let staged: Vec<Staged> = (0..4)
        .map(|k| {
            let mut file = temporary_file(folders[k % 2]).unwrap();
            file.write_all(b"new").unwrap();
            let target = folders[k % 2].join(format!("{k}"));
            Staged { content: Content::File(file), name: target.clone(), target }
        })
        .collect();
    let mut places = folders.map(Path::to_path_buf).to_vec();
    places.dedup();
    let manifests = if commit { write_manifests(&staged, &places).unwrap() } else { Vec::new() };
    for (k, item) in staged.into_iter().enumerate() {
        let Content::File(file) = item.content else { unreachable!() };
        // Closing the file releases its lock, as the end of a process does.
        let temporary = file.into_temp_path().keep().unwrap();
        if k < renames {
            fs::rename(temporary, item.target).unwrap();
        }
    }
    for (path, _) in manifests {
        let _ = path.keep();
    }
}

#[test]
fn a_committed_set_is_completed_from_any_of_its_folders() {
    for first in [0, 1] {
        for renames in 0..=4 {
            let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
            let paths = [folders[0].path(), folders[1].path()];
            (0..4).for_each(|k| fs::write(paths[k % 2].join(format!("{k}")), "old").unwrap());
            interrupted_commit(paths, true, renames);
            recover_now(paths[first]).unwrap();
            for k in 0..4 {
                assert_eq!(fs::read(paths[k % 2].join(format!("{k}"))).unwrap(), b"new", "{first} {renames}");
            }
            recover_now(paths[1 - first]).unwrap();
            assert_eq!([names(paths[0]), names(paths[1])], [["0", "2"], ["1", "3"]]);
        }
    }
}

#[test]
fn a_set_without_a_complete_manifest_is_removed() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    (0..4).for_each(|k| fs::write(place.join(format!("{k}")), "old").unwrap());
    interrupted_commit([place, place], false, 0);
    temporary_folder(place).map(|(made, _)| fs::write(made.keep().join("0"), "frame").unwrap()).unwrap();
    recover_now(place).unwrap();
    assert_eq!(names(place), ["0", "1", "2", "3"]);
    // A manifest that was cut anywhere, or changed, counts as none.
    for cut in 0..60 {
        interrupted_commit([place, place], true, 0);
        let name = names(place).into_iter().find(|n| n.ends_with(MANIFEST)).unwrap();
        let bytes = fs::read(place.join(&name)).unwrap();
        let mut bytes = bytes[..bytes.len() * cut / 60].to_vec();
        if cut % 2 == 1 {
            let last = bytes.len() - 1;
            bytes[last] ^= 1;
        }
        fs::write(place.join(&name), bytes).unwrap();
        recover_now(place).unwrap();
        assert_eq!(names(place), ["0", "1", "2", "3"], "{cut}");
        assert!((0..4).all(|k| fs::read(place.join(format!("{k}"))).unwrap() == b"old"), "{cut}");
    }
}

#[test]
fn files_of_a_running_process_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    write_as_set(|| {
        write(&folder.path().join("a"), "new")?;
        recover_now(folder.path()).unwrap();
        assert_eq!(names(folder.path()).len(), 1);
        Ok(())
    })
    .unwrap();
    assert_eq!(names(folder.path()), ["a"]);
}

#[cfg(unix)]
#[test]
fn the_mode_of_an_older_file_is_kept() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a");
    fs::write(&path, "old").unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
    write(&path, "new").unwrap();
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o640);
}
