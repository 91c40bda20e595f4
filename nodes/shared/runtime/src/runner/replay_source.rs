use super::links::TICK;
use super::{Ending, RunError, Runner};
use crate::board::Word;
use crate::clock::monotonic_ns;
use crate::{Node, Produced};
use std::time::Duration;

impl<N: Node> Runner<'_, N> {
    /// The loop of a source in replay: keeps the window full until the last frame is acknowledged.
    pub(super) fn replay_frames(&mut self) -> Result<Ending, RunError> {
        let launch = self.launch;
        let (mut next, mut seen) = (launch.acknowledged_by_all(), Vec::new());
        loop {
            let acknowledged = launch.acknowledged_by_all();
            if launch.board.total().is_some_and(|total| acknowledged >= total) {
                return Ok(Ending::InOrder);
            }
            let generations = launch.board.generations();
            if launch.board.all_came() && generations != seen {
                // Somebody has come (back): all that is not acknowledged goes out again.
                (next, seen) = (acknowledged, generations);
            }
            if launch.board.stop_requested() && launch.board.total().is_none() {
                // All that was ever sent, so that every sink ends at the same frame.
                let sent = launch.board.get(launch.me, Word::Frames);
                launch.board.set_total(sent.max(next).max(acknowledged));
                continue;
            }
            let open = !seen.is_empty() && next < acknowledged + launch.plan.window;
            let more = launch.board.total().is_none_or(|total| next < total);
            let pause = match open && more {
                true => self.replay_frame(&mut next)?,
                false => Some(TICK),
            };
            if let Some(pause) = pause
                && self.sleep(pause)?
            {
                return Ok(Ending::Terminated);
            }
        }
    }

    /// Sends one frame; returns how long to wait when there is none yet.
    fn replay_frame(&mut self, next: &mut u64) -> Result<Option<Duration>, RunError> {
        let (launch, index) = (self.launch, *next);
        let place = || format!("frame {index}");
        let begin_ns = monotonic_ns();
        launch.beat(Some(index));
        self.outputs.begin(None, begin_ns);
        let produced = self.node.produce(index, &mut self.outputs, &self.context);
        match produced.map_err(|error| launch.node_error(place(), &error))? {
            Produced::Nothing => return Ok(Some(Duration::from_millis(1))),
            Produced::End => {
                launch.board.set_total(index);
                return Ok(None);
            }
            Produced::Frame(key) if key.index != index => {
                return Err(launch.error(place(), format!("the source made frame {} instead", key.index)));
            }
            Produced::Frame(_) => {}
        }
        self.outputs.end().map_err(|error| launch.error(place(), error.to_string()))?;
        self.links.ring_consumers();
        *next = index + 1;
        if index < launch.board.get(launch.me, Word::Frames) {
            launch.board.add(launch.me, Word::Repeats, 1);
        } else {
            launch.board.count_frame(launch.me, begin_ns, monotonic_ns(), begin_ns);
        }
        Ok(None)
    }
}
