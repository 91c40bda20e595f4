use std::io::{IsTerminal, Write, stderr};
use std::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_millis(500);

/// The table below the log lines of a terminal; log lines alone where there is no terminal.
pub(super) struct LiveTable {
    print: bool,
    terminal: bool,
    shown: String,
    next: Instant,
}

impl LiveTable {
    pub(super) fn new(print: bool) -> Self {
        let terminal = print && stderr().is_terminal();
        Self { print, terminal, shown: String::new(), next: Instant::now() + PERIOD }
    }

    pub(super) fn is_due(&self) -> bool {
        self.terminal && Instant::now() >= self.next
    }

    /// Replaces the table.
    pub(super) fn show(&mut self, table: &str) {
        self.next = Instant::now() + PERIOD;
        self.write(&format!("{}{table}", erase(&self.shown)));
        self.shown = table.to_owned();
    }

    /// Prints a line above the table.
    pub(super) fn say(&mut self, line: &str) {
        if self.print {
            self.write(&format!("{}{line}\n{}", erase(&self.shown), self.shown));
        }
    }

    /// Takes the table away.
    pub(super) fn clear(&mut self) {
        self.write(&erase(&self.shown));
        self.shown.clear();
    }

    fn write(&self, text: &str) {
        // Nobody can be told when standard error is closed.
        let mut out = stderr().lock();
        let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
    }
}

/// Moves up to where a table begins and erases from there.
fn erase(table: &str) -> String {
    match table.lines().count() {
        0 => String::new(),
        lines => format!("\x1b[{lines}A\x1b[J"),
    }
}
