//! Copies of a store: whole, equal, taken beside a writer, never over a store.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::archive::*;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tirante::site::store::{self, Durability, Reader, Store};

fn backup(store: &Path, target: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tirante"))
        .arg("backup")
        .arg("--store")
        .arg(store)
        .arg(target)
        .output()
        .unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn dump(path: &Path) -> String {
    Reader::open(path).unwrap().dump().unwrap()
}

#[test]
fn a_copy_taken_beside_the_writer_holds_everything_committed_and_goes_on_as_a_store() {
    let folder = tempfile::tempdir().unwrap();
    let (path, copy) = (
        folder.path().join("site.sqlite"),
        folder.path().join("copy.sqlite"),
    );
    let mut store = Store::open(&path, Durability::Full).unwrap();
    fill(&mut store, 0..30);
    let output = backup(&path, &copy);
    assert!(output.status.success(), "{}", said(&output));
    assert!(String::from_utf8_lossy(&output.stdout).contains("bytes, checked"));
    assert_eq!(dump(&copy), dump(&path));
    assert!(!folder.path().join("copy.sqlite-wal").exists(), "one file");

    fs::write(
        folder.path().join("copy.sqlite.part"),
        "what a broken-off copy left",
    )
    .unwrap();
    fill(&mut store, 30..50);
    assert!(
        backup(&path, &copy).status.success(),
        "the older copy is replaced"
    );
    assert_eq!(dump(&copy), dump(&path));
    assert!(!folder.path().join("copy.sqlite.part").exists());

    let restored = Store::open(&copy, Durability::Full).unwrap();
    assert!(restored.moved_aside().is_none());
    assert_eq!(restored.all_known(), store.all_known());
}

#[test]
fn no_store_is_written_over_and_no_damage_is_copied() {
    let folder = tempfile::tempdir().unwrap();
    let (path, other) = (
        folder.path().join("site.sqlite"),
        folder.path().join("other.sqlite"),
    );
    fill(&mut Store::open(&path, Durability::Full).unwrap(), 0..10);
    drop(Store::open(&other, Durability::Full).unwrap());
    let before = (fs::read(&path).unwrap(), fs::read(&other).unwrap());
    std::os::unix::fs::symlink(&path, folder.path().join("link")).unwrap();
    for target in [
        &path,
        &other,
        &folder.path().join("link"),
        &folder.path().to_owned(),
    ] {
        let output = backup(&path, target);
        assert_eq!(output.status.code(), Some(1), "{}", target.display());
        assert!(said(&output).contains("name another file"), "{}", said(&output));
    }
    assert_eq!(before, (fs::read(&path).unwrap(), fs::read(&other).unwrap()));

    let lost = folder.path().join("no/such/folder/copy");
    let output = backup(&path, &lost);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        said(&output).contains("no/such/folder does not exist"),
        "{}",
        said(&output)
    );

    // Changed letters in the lines of records: SQLite sees nothing, the checksums of the rows do.
    let mut bytes = fs::read(&path).unwrap();
    let key = b"\"duration_s\":";
    let places: Vec<usize> = (0..bytes.len() - key.len())
        .filter(|at| bytes[*at..].starts_with(key))
        .collect();
    assert!(places.len() >= 10);
    for at in places {
        bytes[at + 1] = b'D';
    }
    fs::write(&path, bytes).unwrap();
    let copy = folder.path().join("copy.sqlite");
    let output = backup(&path, &copy);
    assert_eq!(output.status.code(), Some(1));
    assert!(said(&output).contains("is damaged"), "{}", said(&output));
    assert!(!copy.exists(), "the last good copy would still be there");
}

#[test]
fn a_copy_that_was_looked_at_is_replaced_by_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let [path, copy] = ["site.sqlite", "copy.sqlite"].map(|name| folder.path().join(name));
    let writer = Store::open(&path, Durability::Full).unwrap();
    assert_eq!(backup(&path, &copy).status.code(), Some(0));
    assert_eq!(store::is_held(&path), Some(true));
    assert!(store::held(&path).is_some());
    assert_eq!(store::is_held(&copy), Some(false));
    assert!(store::held(&copy).is_none());
    assert_eq!(backup(&path, &copy).status.code(), Some(0));
    // Who asks takes the lock from nobody.
    drop(writer);
    assert_eq!(store::is_held(&path), Some(false));
    drop(Store::open(&path, Durability::Full).unwrap());
}
