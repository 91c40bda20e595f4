//! YAML of strangers: `serde_yaml` with limits on what it is given.

use serde::de::{DeserializeOwned, Error};

/// A graph, or the metadata of a bag of very many topics, is smaller.
const MOST_BYTES: usize = 16 << 20;
/// Brackets that may be open at once. The scanner's work grows with their square: 100 KB of `[` cost half a minute.
const MOST_OPEN: usize = 1000;

/// Reads a document.
///
/// # Errors
/// When it is no YAML, no `T`, larger than 16 MiB, or has over a thousand brackets open at once (those in strings and
/// comments are counted as well).
pub fn from_str<T: DeserializeOwned>(text: &str) -> Result<T, serde_yaml::Error> {
    if text.len() > MOST_BYTES {
        return Err(Error::custom(format!("{} bytes; at most {MOST_BYTES} are read", text.len())));
    }
    if most_open(text) > MOST_OPEN {
        return Err(Error::custom(format!("over {MOST_OPEN} brackets are open at once")));
    }
    serde_yaml::from_str(text)
}

fn most_open(text: &str) -> usize {
    let (mut open, mut most) = (0_usize, 0);
    for byte in text.bytes() {
        match byte {
            b'[' | b'{' => open += 1,
            b']' | b'}' => open = open.saturating_sub(1),
            _ => {}
        }
        most = most.max(open);
    }
    most
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_yaml::Value;

    #[test]
    fn depth_and_size_are_limited() {
        let read = |text: &str| from_str::<Value>(text).map_err(|error| error.to_string());
        assert!(read("a: [1, {b: [c]}]").is_ok());
        assert!(read(&"[".repeat(100_000)).unwrap_err().contains("open at once"));
        assert!(read(&"{a: [".repeat(50_000)).unwrap_err().contains("open at once"));
        assert!(read(&"- ".repeat(50_000)).unwrap_err().contains("recursion limit"));
        assert!(read(&"#".repeat(MOST_BYTES + 1)).unwrap_err().contains("are read"));
    }
}
