//! README and tutorials are followed, command by command. A block marked `<!-- parsed: REASON -->` (a robot, hours of training) is not
//! run: its options and settings must exist, and the files that it reads.

mod blocks;
#[path = "../common/mod.rs"]
mod common;
mod reader;

use blocks::{Block, blocks, commands};
use common::root;
use reader::Reader;

fn follow(document: &str) -> Reader {
    let reader = Reader::new();
    let blocks = blocks(&root().join(document));
    assert!(!blocks.is_empty(), "{document} has no commands");
    for block in &blocks {
        let line = block.line;
        reader.follow(block).unwrap_or_else(|problem| panic!("{document}, line {line}: {problem}"));
    }
    reader
}

#[test]
fn the_readme() {
    follow("README.md");
}

#[test]
fn your_own_object() {
    let reader = follow("docs/tutorials/own-object.md");
    let overlays = std::fs::read_dir(reader.folder().join("out/contour/overlays")).expect("pictures");
    assert_eq!(overlays.count(), 15, "one picture for each frame");
}

#[test]
fn better_in_your_own_room() {
    follow("docs/tutorials/adapt.md");
}

#[test]
fn on_a_robot() {
    follow("docs/tutorials/robot.md");
}

/// Pages to look things up have commands about data of no reader in particular: their options must exist.
#[test]
fn commands_of_all_other_pages_exist() {
    let reader = Reader::new();
    let pages = std::fs::read_dir(root().join("docs")).expect("docs").flatten().map(|entry| entry.path());
    let pages = pages.filter(|path| path.extension().is_some_and(|e| e == "md"));
    let mut tried = 0;
    for page in pages {
        for words in blocks(&page).iter().flat_map(|block| commands(&block.text)) {
            if !words.contains(&"--ros-args".to_owned()) {
                reader.parse(&words, false).unwrap_or_else(|problem| panic!("{}: {problem}", page.display()));
                tried += 1;
            }
        }
    }
    assert!(tried > 10, "{tried} commands");
}

#[test]
fn what_does_not_work_is_found() {
    let reader = Reader::new();
    let problem = |text: &str, parsed: Option<&str>| {
        let block = Block { line: 1, text: text.into(), parsed: parsed.map(str::to_owned) };
        reader.follow(&block).expect_err(text)
    };
    let parsed = Some("it takes hours");
    assert!(problem("pseudoflow check config/graphs/refine.yaml --set sise_px=64\necho on", None).contains("sise_px"));
    assert!(problem("pseudoflow adapt --bag my_bag --stepps 3", parsed).contains("--stepps"));
    assert!(
        problem("pseudoflow adapt --bag my_bag --weights config/weights/gone.safetensors", parsed).contains("gone")
    );
    assert!(
        problem("pseudoflow run config/graphs/refine.yaml --set sise_px=64 --out out/a", parsed).contains("sise_px")
    );
    assert!(problem("cargo test", None).contains("cargo run --release --"));
    assert!(problem("tests/walk", parsed).contains("no such program"));
}
