use crate::ipc::{Bell, IpcError, Sleeper};
use crate::plan::Plan;
use iceoryx2::prelude::{Node, ipc};
use std::time::Duration;

/// The longest sleep: nodes are woken by bells, this only bounds what a bell lost in a kill can cost.
pub(super) const TICK: Duration = Duration::from_millis(250);

/// Whom a node wakes and what wakes it.
pub(super) struct Links {
    sleeper: Sleeper,
    bells: Vec<(usize, Bell)>,
    consumers: Vec<usize>,
    producers: Vec<usize>,
    source: usize,
    /// Dropped last: everything above lives in it.
    _node: Node<ipc::Service>,
}

impl Links {
    pub(super) fn new(node: Node<ipc::Service>, plan: &Plan, me: usize) -> Result<Self, IpcError> {
        let (consumers, producers, source) = (plan.consumers(me), plan.producers(me), plan.source);
        let mut others: Vec<usize> = consumers.iter().chain(&producers).copied().chain([source]).collect();
        others.sort_unstable();
        others.dedup();
        let bell = |other: usize| Ok((other, Bell::of(&node, &plan.nodes[other].name, plan.nodes.len())?));
        let bells = others.into_iter().filter(|other| *other != me).map(bell).collect::<Result<_, IpcError>>()?;
        let sleeper = Sleeper::new(&node, &plan.nodes[me].name, plan.nodes.len())?;
        Ok(Self { sleeper, bells, consumers, producers, source, _node: node })
    }

    pub(super) fn sleep(&mut self, at_most: Duration) -> Result<bool, IpcError> {
        self.sleeper.sleep(at_most)
    }

    fn ring(&self, wanted: impl Fn(usize) -> bool) {
        self.bells.iter().filter(|(node, _)| wanted(*node)).for_each(|(_, bell)| bell.ring());
    }

    pub(super) fn ring_consumers(&self) {
        self.ring(|node| self.consumers.contains(&node));
    }

    pub(super) fn ring_producers(&self) {
        self.ring(|node| self.producers.contains(&node));
    }

    pub(super) fn ring_source(&self) {
        self.ring(|node| node == self.source);
    }
}
