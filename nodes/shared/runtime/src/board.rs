//! What the processes of a run know of each other: one small file, mapped by all of them.
//!
//! Every value is one atomic word, so a process that is killed leaves no half-written state, and its successor
//! reads where the run stands: which frames are acknowledged, how often each node began, when the run is to end.
//! Messages never pass here.

use crate::histogram::{self, BUCKETS};
use memmap2::MmapRaw;
use std::fs::OpenOptions;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

const MAGIC: u64 = 0x7066_626f_6172_6405;
const HEADER_WORDS: usize = 16;
const NODE_WORDS: usize = 704;
/// Frames, and ns of work in them, by their number of objects.
const OBJECT_FRAMES: usize = 16;
const OBJECT_NS: usize = OBJECT_FRAMES + OBJECTS;
const WORK: usize = OBJECT_NS + OBJECTS;
const AGE: usize = WORK + BUCKETS;
/// Frames dropped by the input that they could not be used for.
const BAD_FROM: usize = AGE + BUCKETS;
/// Why the last bad frame was dropped: UTF-8, zero behind it.
const CAUSE: usize = NODE_WORDS - CAUSE_WORDS;
const CAUSE_WORDS: usize = 64;
/// Numbers of objects that are told apart; the last one stands for all above.
pub(crate) const OBJECTS: usize = 24;
const UNKNOWN: u64 = u64::MAX;

/// Words of the header.
enum Header {
    Magic = 0,
    Nodes = 1,
    Stop = 2,
    Total = 3,
}

/// Words of a node.
#[derive(Clone, Copy)]
pub(crate) enum Word {
    /// Process id of the node's current life.
    Pid = 0,
    /// A [`State`].
    State = 1,
    /// Counts how often the node became ready.
    Generation = 2,
    /// Counts restarts.
    Restarts = 3,
    /// All frames below this one are safe with this node.
    Acknowledged = 4,
    /// Frames that were handled, each once.
    Frames = 5,
    /// Frames given up for newer ones.
    Drops = 6,
    /// Frames that were handled again after a death.
    Repeats = 7,
    /// When the first frame began, monotonic ns.
    FirstNs = 8,
    /// When the last frame ended, monotonic ns.
    LastNs = 9,
    /// Time spent in frames, ns.
    WorkNs = 10,
    /// Frames dropped because they could not be used.
    Bad = 11,
    /// Last sign of life, monotonic ns: a node gives one whenever it looks for work and before it begins any.
    Beat = 12,
    /// The frame that it works on, plus one; 0 while it waits.
    At = 13,
    /// CPU time of the process before it was ready, all its lives and threads, ns.
    StartCpuNs = 14,
    /// CPU time of the process since it was ready, all its lives and threads, ns.
    CpuNs = 15,
}

/// Where a node stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum State {
    /// Not there, or not ready yet.
    Away = 0,
    /// Its ports are connected and it waits for frames.
    Ready = 1,
    /// It has seen the end of the run and closed what it kept.
    Finished = 2,
    /// It has seen its last frame and closes what would be lost otherwise.
    Closing = 3,
}

/// The mapped file.
#[derive(Debug)]
pub(crate) struct Board {
    map: MmapRaw,
    nodes: usize,
}

impl Board {
    /// Makes the file of a run, all zero but for the unknown end.
    pub(crate) fn create(path: &Path, nodes: usize) -> std::io::Result<Self> {
        let file = OpenOptions::new().read(true).write(true).create_new(true).open(path)?;
        file.set_len(((HEADER_WORDS + nodes * NODE_WORDS) * 8) as u64)?;
        let board = Self { map: MmapRaw::map_raw(&file)?, nodes };
        board.header(Header::Nodes).store(nodes as u64, Ordering::Relaxed);
        board.header(Header::Total).store(UNKNOWN, Ordering::Relaxed);
        board.header(Header::Magic).store(MAGIC, Ordering::Release);
        Ok(board)
    }

    /// Maps the file of a run.
    pub(crate) fn open(path: &Path) -> std::io::Result<Self> {
        let file = OpenOptions::new().read(true).write(true).open(path)?;
        let len = file.metadata()?.len() as usize;
        let invalid = || std::io::Error::new(std::io::ErrorKind::InvalidData, "not the state of a run of this version");
        if len < HEADER_WORDS * 8 {
            return Err(invalid());
        }
        let mut board = Self { map: MmapRaw::map_raw(&file)?, nodes: 0 };
        board.nodes = board.header(Header::Nodes).load(Ordering::Relaxed) as usize;
        let whole = board.header(Header::Magic).load(Ordering::Acquire) == MAGIC
            && len == (HEADER_WORDS + board.nodes * NODE_WORDS) * 8;
        if whole { Ok(board) } else { Err(invalid()) }
    }

    fn words(&self) -> &[AtomicU64] {
        // SAFETY: the mapping is page-aligned, lives as long as `self`, is only ever accessed through these
        // atomics by all processes, and its length is a whole number of words.
        unsafe { std::slice::from_raw_parts(self.map.as_ptr().cast::<AtomicU64>(), self.map.len() / 8) }
    }

    fn header(&self, word: Header) -> &AtomicU64 {
        &self.words()[word as usize]
    }

    fn slot(&self, node: usize) -> &[AtomicU64] {
        &self.words()[HEADER_WORDS + node * NODE_WORDS..][..NODE_WORDS]
    }

    pub(crate) fn get(&self, node: usize, word: Word) -> u64 {
        self.slot(node)[word as usize].load(Ordering::Acquire)
    }

    pub(crate) fn set(&self, node: usize, word: Word, value: u64) {
        self.slot(node)[word as usize].store(value, Ordering::Release);
    }

    pub(crate) fn add(&self, node: usize, word: Word, value: u64) {
        self.slot(node)[word as usize].fetch_add(value, Ordering::AcqRel);
    }

    pub(crate) fn state(&self, node: usize) -> State {
        match self.get(node, Word::State) {
            1 => State::Ready,
            2 => State::Finished,
            3 => State::Closing,
            _ => State::Away,
        }
    }

    pub(crate) fn set_state(&self, node: usize, state: State) {
        self.set(node, Word::State, state as u64);
    }

    /// Counts of lives by node: they change when a node has come back and needs its frames again.
    pub(crate) fn generations(&self) -> Vec<u64> {
        (0..self.nodes).map(|node| self.get(node, Word::Generation)).collect()
    }

    pub(crate) fn all_came(&self) -> bool {
        self.generations().iter().all(|generation| *generation > 0)
    }

    pub(crate) fn request_stop(&self) {
        self.header(Header::Stop).store(1, Ordering::Release);
    }

    pub(crate) fn stop_requested(&self) -> bool {
        self.header(Header::Stop).load(Ordering::Acquire) != 0
    }

    /// How many frames the run has, once the source knows.
    pub(crate) fn total(&self) -> Option<u64> {
        Some(self.header(Header::Total).load(Ordering::Acquire)).filter(|total| *total != UNKNOWN)
    }

    pub(crate) fn set_total(&self, total: u64) {
        self.header(Header::Total).store(total, Ordering::Release);
    }

    /// Counts a frame that a node has handled: when it began, how long it took, how old it is since its source.
    pub(crate) fn count_frame(&self, node: usize, begin_ns: u64, end_ns: u64, origin_ns: u64) {
        let slot = self.slot(node);
        let first = &slot[Word::FirstNs as usize];
        let _ = first.compare_exchange(0, begin_ns, Ordering::AcqRel, Ordering::Relaxed);
        slot[Word::LastNs as usize].store(end_ns, Ordering::Release);
        slot[Word::Frames as usize].fetch_add(1, Ordering::AcqRel);
        slot[Word::WorkNs as usize].fetch_add(end_ns.saturating_sub(begin_ns), Ordering::AcqRel);
        histogram::record(&slot[WORK..AGE], end_ns.saturating_sub(begin_ns));
        histogram::record(&slot[AGE..AGE + BUCKETS], end_ns.saturating_sub(origin_ns));
    }

    /// Counts frames that could not be used, and by which of the node's inputs they came; a source takes them from outside.
    pub(crate) fn count_bad(&self, node: usize, input: Option<usize>, frames: u64, cause: &str) {
        // Word by word: who reads at this moment sees two causes in one, which is for people only.
        let mut bytes = [0; 8 * CAUSE_WORDS];
        let len = cause.len().min(bytes.len());
        bytes[..len].copy_from_slice(&cause.as_bytes()[..len]);
        for (word, chunk) in self.slot(node)[CAUSE..].iter().zip(bytes.as_chunks::<8>().0) {
            word.store(u64::from_le_bytes(*chunk), Ordering::Relaxed);
        }
        self.add(node, Word::Bad, frames);
        if let Some(from) = input.and_then(|input| self.bad_words(node).get(input)) {
            from.fetch_add(frames, Ordering::AcqRel);
        }
    }

    fn bad_words(&self, node: usize) -> &[AtomicU64] {
        &self.slot(node)[BAD_FROM..CAUSE]
    }

    /// Frames that could not be used for an input of a node.
    pub(crate) fn bad_from(&self, node: usize, input: usize) -> u64 {
        self.bad_words(node).get(input).map_or(0, |from| from.load(Ordering::Acquire))
    }

    /// Why the last bad frame of a node was dropped.
    pub(crate) fn last_bad(&self, node: usize) -> Option<String> {
        let words = self.slot(node)[CAUSE..].iter();
        let bytes: Vec<u8> = words.flat_map(|word| word.load(Ordering::Relaxed).to_le_bytes()).collect();
        let len = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
        (self.get(node, Word::Bad) > 0).then(|| String::from_utf8_lossy(&bytes[..len]).into_owned())
    }

    /// A node's sign of life, and the frame that it begins.
    pub(crate) fn beat(&self, node: usize, now_ns: u64, frame: Option<u64>) {
        self.set(node, Word::At, frame.map_or(0, |frame| frame.saturating_add(1)));
        self.set(node, Word::Beat, now_ns);
    }

    /// Counts the work of a frame with so many objects.
    pub(crate) fn count_objects(&self, node: usize, objects: usize, work_ns: u64) {
        let (slot, at) = (self.slot(node), objects.min(OBJECTS - 1));
        slot[OBJECT_FRAMES + at].fetch_add(1, Ordering::AcqRel);
        slot[OBJECT_NS + at].fetch_add(work_ns, Ordering::AcqRel);
    }

    /// Frames with so many objects, and the mean milliseconds of work in them; `None` when there were none.
    pub(crate) fn objects(&self, node: usize, objects: usize) -> Option<(u64, f64)> {
        let slot = self.slot(node);
        let frames = slot[OBJECT_FRAMES + objects].load(Ordering::Acquire);
        let ns = slot[OBJECT_NS + objects].load(Ordering::Acquire);
        (frames > 0).then(|| (frames, ns as f64 * 1e-6 / frames as f64))
    }

    /// Milliseconds spent in a frame, by share of frames.
    pub(crate) fn work_ms(&self, node: usize, share: f64) -> Option<f64> {
        histogram::quantile_ms(&self.slot(node)[WORK..AGE], share)
    }

    /// Milliseconds from the source to this node's end of a frame, by share of frames.
    pub(crate) fn age_ms(&self, node: usize, share: f64) -> Option<f64> {
        histogram::quantile_ms(&self.slot(node)[AGE..AGE + BUCKETS], share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_one_writes_all_read_also_after_it_is_gone() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("board");
        let board = Board::create(&path, 3).unwrap();
        let other = Board::open(&path).unwrap();
        assert_eq!((other.total(), other.stop_requested(), other.state(2)), (None, false, State::Away));
        other.set_total(7);
        other.set(2, Word::Acknowledged, 5);
        other.set_state(2, State::Ready);
        other.count_frame(2, 1_000_000, 3_000_000, 500_000);
        other.count_objects(2, 3, 2_000_000);
        other.count_objects(2, 3, 4_000_000);
        other.count_objects(2, 1000, 5_000_000);
        other.count_bad(1, Some(3), 1, &"x".repeat(1000));
        other.count_bad(1, None, 4, "input `frame`: 0 x 0 pixels");
        other.count_bad(2, Some(1000), 1, &"é".repeat(1000));
        drop(other);
        assert_eq!((board.get(1, Word::Bad), board.last_bad(0)), (5, None));
        assert_eq!([0, 3, 1000].map(|input| board.bad_from(1, input)), [0, 1, 0]);
        assert_eq!(board.last_bad(1).as_deref(), Some("input `frame`: 0 x 0 pixels"));
        assert_eq!(board.last_bad(2), Some("é".repeat(256)));
        assert_eq!((board.objects(2, 3), board.objects(2, OBJECTS - 1)), (Some((2, 3.0)), Some((1, 5.0))));
        assert_eq!((board.objects(2, 2), board.objects(1, 3)), (None, None));
        assert_eq!((board.total(), board.get(2, Word::Acknowledged), board.state(2)), (Some(7), 5, State::Ready));
        assert_eq!(board.get(1, Word::Acknowledged), 0);
        assert!((1.8..2.2).contains(&board.work_ms(2, 0.5).unwrap()));
        assert!((2.2..2.8).contains(&board.age_ms(2, 0.5).unwrap()));
        assert!(Board::create(&path, 3).is_err());
        std::fs::write(&path, [0; 512]).unwrap();
        assert!(Board::open(&path).is_err());
    }
}
