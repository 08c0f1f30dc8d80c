//! A disk in memory that distinguishes synced data from data that are only in the cache of the operating
//! system.
//!
//! After a kill of the process, all written data remain. After a power cut, synced data remain, in addition
//! to any of the unsynced sectors and the first unsynced name changes of each folder. A process can end
//! between any two operations.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Component, Path};
use std::time::SystemTime;

use tandem_store::disk::{FileKind, FileMetadata, OpenMode};

use super::ROOT;

/// Sector size in bytes; a power cut keeps or loses a sector as a whole.
const SECTOR: usize = 512;

pub(super) fn ended() -> io::Error {
    io::Error::other("the process has ended")
}

/// Faults that a test sets on a disk.
#[derive(Debug, Clone, Default)]
pub struct Faults {
    /// Operations that change something fail with this error.
    pub refuses: Option<io::ErrorKind>,
    /// Number of the changing operation, from the mount of the disk, at which the process ends.
    pub dies_at: Option<u64>,
    /// Syncs have no effect, as on a defective disk.
    pub forgets_syncs: bool,
    /// Writes of JSON lines at an offset are dropped, as by a defect of the program. Only the journal's ring
    /// writes such lines.
    pub forgets_ahead: bool,
}

/// Content and faults of a simulated disk.
#[derive(Debug)]
pub struct DiskModel {
    nodes: BTreeMap<u64, Node>,
    next: u64,
    /// Number of the process that has mounted the disk.
    pub(super) process: u64,
    /// True if that process has ended.
    pub(super) is_dead: bool,
    /// Number of operations that have changed something since the process started.
    pub operations: u64,
    /// Faults of the disk.
    pub faults: Faults,
    /// The simulated time of day.
    pub now: SystemTime,
    random: u64,
}

#[derive(Debug, Clone)]
enum Node {
    File(FileNode),
    Folder(FolderNode),
}

#[derive(Debug, Clone)]
pub(super) struct FileNode {
    pub now: Vec<u8>,
    kept: Vec<u8>,
    pending: Vec<FileChange>,
    modified: SystemTime,
}

#[derive(Debug, Clone)]
pub(super) enum FileChange {
    Write(u64, Vec<u8>),
    SetLen(u64),
}

#[derive(Debug, Clone, Default)]
struct FolderNode {
    now: BTreeMap<String, u64>,
    kept: BTreeMap<String, u64>,
    pending: Vec<FolderChange>,
}

#[derive(Debug, Clone)]
enum FolderChange {
    Link(String, u64),
    Unlink(String),
    Rename(String, String),
}

impl FolderChange {
    fn apply(&self, names: &mut BTreeMap<String, u64>) {
        match self {
            Self::Link(name, ino) => {
                names.insert(name.clone(), *ino);
            }
            Self::Unlink(name) => {
                names.remove(name);
            }
            Self::Rename(from, to) => {
                if let Some(ino) = names.remove(from) {
                    names.insert(to.clone(), ino);
                }
            }
        }
    }
}

impl FileChange {
    fn apply(&self, bytes: &mut Vec<u8>) {
        match self {
            Self::Write(at, data) => put(bytes, *at, data),
            Self::SetLen(length) => bytes.resize(usize::try_from(*length).unwrap(), 0),
        }
    }
}

fn put(bytes: &mut Vec<u8>, at: u64, data: &[u8]) {
    let at = usize::try_from(at).unwrap();
    if bytes.len() < at + data.len() {
        bytes.resize(at + data.len(), 0);
    }
    bytes[at..at + data.len()].copy_from_slice(data);
}

fn missing() -> io::Error {
    io::ErrorKind::NotFound.into()
}

const ROOT_INO: u64 = 1;

impl DiskModel {
    /// Creates an empty disk; `seed` determines the results of faults.
    pub fn new(seed: u64, now: SystemTime) -> Self {
        Self {
            nodes: BTreeMap::from([(ROOT_INO, Node::Folder(FolderNode::default()))]),
            next: ROOT_INO + 1,
            process: 0,
            is_dead: false,
            operations: 0,
            faults: Faults::default(),
            now,
            random: seed,
        }
    }

    fn chance(&mut self, of: u64) -> u64 {
        self.random = (self.random)
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.random >> 33) % of
    }

    /// Counts an operation that changes something, and applies the faults; every such operation calls this
    /// first.
    fn change(&mut self) -> io::Result<()> {
        self.operations += 1;
        if self.faults.dies_at.is_some_and(|at| self.operations >= at) {
            self.kill();
            return Err(ended());
        }
        match self.faults.refuses {
            Some(kind) => Err(kind.into()),
            None => Ok(()),
        }
    }

    /// Ends the process: its later operations do not reach the disk.
    pub fn kill(&mut self) {
        self.is_dead = true;
        self.faults.dies_at = None;
    }

    pub(super) fn find(&self, path: &Path) -> io::Result<u64> {
        let mut ino = ROOT_INO;
        for part in path.strip_prefix(ROOT).map_err(|_| missing())?.components() {
            let Component::Normal(name) = part else { continue };
            let Some(Node::Folder(folder)) = self.nodes.get(&ino) else {
                return Err(io::ErrorKind::NotADirectory.into());
            };
            ino = *folder.now.get(name.to_str().unwrap()).ok_or_else(missing)?;
        }
        Ok(ino)
    }

    fn folder_of(&mut self, path: &Path) -> io::Result<(&mut FolderNode, String)> {
        let name = path.file_name().ok_or_else(missing)?.to_str().unwrap().to_owned();
        let ino = self.find(path.parent().ok_or_else(missing)?)?;
        match self.nodes.get_mut(&ino) {
            Some(Node::Folder(folder)) => Ok((folder, name)),
            _ => Err(io::ErrorKind::NotADirectory.into()),
        }
    }

    fn enter(&mut self, path: &Path, entry: impl FnOnce(String) -> FolderChange) -> io::Result<()> {
        let (folder, name) = self.folder_of(path)?;
        let entry = entry(name);
        entry.apply(&mut folder.now);
        folder.pending.push(entry);
        Ok(())
    }

    fn add(&mut self, path: &Path, node: Node) -> io::Result<u64> {
        self.change()?;
        let ino = self.next;
        self.enter(path, |name| FolderChange::Link(name, ino))?;
        self.next += 1;
        self.nodes.insert(ino, node);
        Ok(ino)
    }

    /// Opens a file, or creates it if the mode requires that; returns the number of the file.
    pub(super) fn open(&mut self, path: &Path, mode: OpenMode) -> io::Result<u64> {
        let creates = matches!(
            mode,
            OpenMode::ReadAppend | OpenMode::ReadWrite | OpenMode::CreateNew
        );
        match self.find(path) {
            Ok(_) if mode == OpenMode::CreateNew => Err(io::ErrorKind::AlreadyExists.into()),
            Ok(ino) => Ok(ino),
            Err(error) if error.kind() == io::ErrorKind::NotFound && creates => {
                let file = FileNode {
                    now: Vec::new(),
                    kept: Vec::new(),
                    pending: Vec::new(),
                    modified: self.now,
                };
                self.add(path, Node::File(file))
            }
            Err(error) => Err(error),
        }
    }

    pub(super) fn make_folder(&mut self, path: &Path, is_recursive: bool) -> io::Result<()> {
        match self.find(path) {
            Ok(_) if is_recursive => return Ok(()),
            Ok(_) => return Err(io::ErrorKind::AlreadyExists.into()),
            Err(_) => {}
        }
        if let Some(parent) = path.parent().filter(|_| is_recursive && path != Path::new(ROOT)) {
            self.make_folder(parent, true)?;
        }
        self.add(path, Node::Folder(FolderNode::default())).map(drop)
    }

    pub(super) fn names(&self, path: &Path) -> io::Result<Vec<String>> {
        match &self.nodes[&self.find(path)?] {
            Node::Folder(folder) => Ok(folder.now.keys().cloned().collect()),
            Node::File(_) => Err(io::ErrorKind::NotADirectory.into()),
        }
    }

    pub(super) fn metadata(&self, path: &Path) -> io::Result<FileMetadata> {
        self.metadata_of(self.find(path)?)
    }

    pub(super) fn metadata_of(&self, ino: u64) -> io::Result<FileMetadata> {
        let (kind, length, modified) = match self.nodes.get(&ino).ok_or_else(missing)? {
            Node::File(file) => (FileKind::File, file.now.len(), file.modified),
            Node::Folder(_) => (FileKind::Folder, 0, self.now),
        };
        let modified = modified
            .duration_since(SystemTime::UNIX_EPOCH)
            .unwrap_or_default();
        Ok(FileMetadata {
            kind,
            length: length as u64,
            mode: 0o600,
            modified: (modified.as_secs().cast_signed(), modified.subsec_nanos()),
            identity: (0, ino),
        })
    }

    pub(super) fn remove(&mut self, path: &Path) -> io::Result<()> {
        if let Node::Folder(_) = self.nodes[&self.find(path)?] {
            return Err(io::ErrorKind::IsADirectory.into());
        }
        self.change()?;
        self.enter(path, FolderChange::Unlink)
    }

    /// Renames an entry; both names must be in the same folder.
    pub(super) fn rename(&mut self, from: &Path, to: &Path) -> io::Result<()> {
        self.find(from)?;
        self.change()?;
        let to = to.file_name().unwrap().to_str().unwrap().to_owned();
        self.enter(from, |from| FolderChange::Rename(from, to))
    }

    pub(super) fn copy(&mut self, from: &Path, to: &Path) -> io::Result<()> {
        let Node::File(mut file) = self.nodes[&self.find(from)?].clone() else {
            return Err(io::ErrorKind::IsADirectory.into());
        };
        file.kept = Vec::new();
        file.pending = vec![FileChange::Write(0, file.now.clone())];
        self.add(to, Node::File(file)).map(drop)
    }

    pub(super) fn file(&mut self, ino: u64) -> io::Result<&mut FileNode> {
        match self.nodes.get_mut(&ino) {
            Some(Node::File(file)) => Ok(file),
            Some(Node::Folder(_)) => Err(io::ErrorKind::IsADirectory.into()),
            None => Err(missing()),
        }
    }

    pub(super) fn alter(&mut self, ino: u64, change: FileChange) -> io::Result<()> {
        let allowed = self.change();
        let now = self.now;
        let change = match (allowed, change) {
            (Ok(()), change) => change,
            // A part of the failed write may be in the file.
            (Err(error), FileChange::Write(at, mut bytes)) => {
                let part = usize::try_from(self.chance(bytes.len() as u64 + 1)).unwrap();
                bytes.truncate(part);
                let file = self.file(ino)?;
                let change = FileChange::Write(at, bytes);
                change.apply(&mut file.now);
                file.pending.push(change);
                return Err(error);
            }
            (Err(error), FileChange::SetLen(_)) => return Err(error),
        };
        let file = self.file(ino)?;
        file.modified = now;
        change.apply(&mut file.now);
        file.pending.push(change);
        Ok(())
    }

    pub(super) fn sync(&mut self, ino: u64) -> io::Result<()> {
        self.change()?;
        if self.faults.forgets_syncs {
            return Ok(());
        }
        match self.nodes.get_mut(&ino).ok_or_else(missing)? {
            Node::File(file) => {
                for change in std::mem::take(&mut file.pending) {
                    change.apply(&mut file.kept);
                }
            }
            Node::Folder(folder) => {
                for entry in std::mem::take(&mut folder.pending) {
                    entry.apply(&mut folder.kept);
                }
            }
        }
        Ok(())
    }

    /// Cuts the power: synced data remain, and any part of the unsynced data.
    pub fn cut_power(&mut self) {
        self.kill();
        let all: Vec<u64> = self.nodes.keys().copied().collect();
        for ino in all {
            let Some(mut node) = self.nodes.remove(&ino) else {
                continue;
            };
            match &mut node {
                Node::File(file) => self.cut_file(file),
                Node::Folder(folder) => {
                    let some = usize::try_from(self.chance(folder.pending.len() as u64 + 1)).unwrap();
                    for entry in folder.pending.drain(..).take(some) {
                        entry.apply(&mut folder.kept);
                    }
                    folder.now.clone_from(&folder.kept);
                }
            }
            self.nodes.insert(ino, node);
        }
        let folders = self.nodes.values().filter_map(|node| match node {
            Node::Folder(folder) => Some(folder.now.values().copied()),
            Node::File(_) => None,
        });
        let named: BTreeSet<u64> = folders.flatten().chain([ROOT_INO]).collect();
        self.nodes.retain(|ino, _| named.contains(ino));
    }

    fn cut_file(&mut self, file: &mut FileNode) {
        let pending = std::mem::take(&mut file.pending);
        if pending.is_empty() {
            return;
        }
        let all_or_none = self.chance(4);
        for change in pending {
            match change {
                _ if all_or_none == 0 => {}
                change if all_or_none == 1 => change.apply(&mut file.kept),
                FileChange::SetLen(_) => {
                    if self.chance(2) == 0 {
                        change.apply(&mut file.kept);
                    }
                }
                FileChange::Write(mut at, bytes) => {
                    let mut rest = bytes.as_slice();
                    while !rest.is_empty() {
                        let room = SECTOR - usize::try_from(at).unwrap() % SECTOR;
                        let (sector, after) = rest.split_at(room.min(rest.len()));
                        if self.chance(2) == 0 {
                            put(&mut file.kept, at, sector);
                        }
                        at += sector.len() as u64;
                        rest = after;
                    }
                }
            }
        }
        file.now.clone_from(&file.kept);
    }

    /// Flips a bit in one of the files that `is_meant` selects; returns the name of the file.
    pub fn flip(&mut self, is_meant: impl Fn(&str) -> bool) -> Option<String> {
        let mut files = Vec::new();
        for node in self.nodes.values() {
            if let Node::Folder(folder) = node {
                let named = folder.now.iter().filter(|(name, _)| is_meant(name));
                files.extend(named.map(|(name, ino)| (name.clone(), *ino)));
            }
        }
        files.retain(|(_, ino)| matches!(&self.nodes[ino], Node::File(file) if !file.now.is_empty()));
        let chosen = self.chance((files.len() as u64).max(1));
        let (name, ino) = files.get(usize::try_from(chosen).unwrap())?.clone();
        let (place, bit) = (self.chance(1 << 30), self.chance(8));
        let file = self.file(ino).ok()?;
        let place = usize::try_from(place).unwrap() % file.now.len();
        file.now[place] ^= 1 << bit;
        file.kept.clone_from(&file.now);
        file.pending.clear();
        Some(name)
    }

    /// Returns a copy of the current content, to which `restore` can reset the disk.
    #[must_use]
    pub fn snapshot(&self) -> Self {
        let faults = self.faults.clone();
        Self {
            nodes: self.nodes.clone(),
            faults,
            ..*self
        }
    }

    /// Resets content and names to those of a snapshot.
    pub fn restore(&mut self, earlier: &Self) {
        self.nodes.clone_from(&earlier.nodes);
        self.next = self.next.max(earlier.next);
    }

    /// Returns a checksum of the whole content of the disk.
    pub fn content_checksum(&self) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        for node in self.nodes.values() {
            match node {
                Node::File(file) => hasher.update(&file.now),
                Node::Folder(folder) => folder.now.keys().for_each(|name| hasher.update(name.as_bytes())),
            }
        }
        hasher.finalize()
    }
}
