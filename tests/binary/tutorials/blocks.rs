//! The commands of a document: its `sh` blocks, and what is said of a block that a test cannot run.

use std::path::Path;

/// What stands before a block that is not run: `<!-- parsed: it needs a camera -->`.
const MARK: &str = "<!-- parsed: ";

/// A block of commands.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Block {
    /// Line of its first command, from 1.
    pub(crate) line: usize,
    pub(crate) text: String,
    /// Why its commands are parsed only; `None` where they are run.
    pub(crate) parsed: Option<String>,
}

/// All `sh` blocks of a document.
///
/// # Panics
/// When the document is not there, a block has no end, or a mark has no reason or no block.
pub(crate) fn blocks(document: &Path) -> Vec<Block> {
    let text = std::fs::read_to_string(document).unwrap_or_else(|e| panic!("{}: {e}", document.display()));
    blocks_of(&text)
}

fn blocks_of(text: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut mark = None;
    let mut lines = text.lines().enumerate();
    while let Some((at, line)) = lines.next() {
        if let Some(reason) = line.strip_prefix(MARK) {
            let reason = reason.strip_suffix("-->").map(str::trim).filter(|reason| !reason.is_empty());
            mark = Some(reason.unwrap_or_else(|| panic!("line {}: a mark without a reason", at + 1)).to_owned());
        } else if line.starts_with("```sh") {
            let inside = lines.by_ref().map(|(_, line)| line).take_while(|line| !line.starts_with("```"));
            let text = inside.collect::<Vec<_>>().join("\n");
            blocks.push(Block { line: at + 2, text, parsed: mark.take() });
        } else if !line.is_empty() {
            assert!(mark.is_none(), "line {}: the mark before it belongs to no block", at + 1);
        }
    }
    blocks
}

/// The commands of a block, each as its words: continued lines joined, comments and quotes gone, and what the shell does with the
/// output.
pub(crate) fn commands(block: &str) -> Vec<Vec<String>> {
    let joined = block.replace("\\\n", " ");
    let command = |line| words(line).into_iter().take_while(|word| !SHELL.contains(&word.as_str())).collect();
    joined.lines().map(command).filter(|words: &Vec<String>| !words.is_empty()).collect()
}

const SHELL: [&str; 4] = [">", "|", "||", "&&"];

/// Words as a shell parts them, for the little that documents use of it.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for c in line.chars() {
        match (c, quote) {
            (c, Some(open)) if c == open => quote = None,
            (c, Some(_)) => word.get_or_insert_default().push(c),
            ('\'' | '"', None) => {
                word.get_or_insert_default();
                quote = Some(c);
            }
            ('#', None) if word.is_none() => break,
            (c, None) if c.is_whitespace() => words.extend(word.take()),
            (c, None) => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    words
}

#[test]
fn blocks_have_lines_text_and_marks() {
    let text = "# A\n\n```sh\none\ntwo # 2\n```\n\n<!-- parsed: it takes a day -->\n```sh\nthree\n```\n```yaml\nfour: 4\n```\n";
    let block =
        |line, text: &str, parsed: Option<&str>| Block { line, text: text.into(), parsed: parsed.map(str::to_owned) };
    assert_eq!(blocks_of(text), [block(4, "one\ntwo # 2", None), block(10, "three", Some("it takes a day"))]);
}

#[test]
fn commands_have_words() {
    let found =
        commands("run a.yaml --set 'frames={start: 2}' \\\n    --out \"b c\"  # why\n\n# nothing\ncheck x#y > z\n");
    assert_eq!(found, [vec!["run", "a.yaml", "--set", "frames={start: 2}", "--out", "b c"], vec!["check", "x#y"]]);
}
