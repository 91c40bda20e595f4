//! Who finds whom, by what the environment says. Real participants on this host.

use pseudoflow_bridge::{BridgeError, DdsEnvironment, DiscoveryRange, Participant, publisher_qos, sensor_qos};
use pseudoflow_msgs::ros::PoseStamped;
use ros2_client::{Name, Publisher, Subscription};
use std::time::{Duration, Instant};

const TOPIC: &str = "/found";

/// Domains from 100 on, two for each run, so that two runs at a time rarely meet.
fn domain() -> u16 {
    100 + (std::process::id() % 60) as u16 * 2
}

fn open(domain_id: u16, range: DiscoveryRange) -> Participant {
    Participant::open(DdsEnvironment { domain_id, range, middleware: None }, "/", "tester").unwrap()
}

fn publish(participant: &mut Participant) -> Result<Publisher<PoseStamped>, BridgeError> {
    participant.publisher(&Name::parse(TOPIC).unwrap(), &publisher_qos(10))
}

fn subscribe(participant: &mut Participant) -> Result<Subscription<PoseStamped>, BridgeError> {
    participant.subscription(&Name::parse(TOPIC).unwrap(), &sensor_qos(10))
}

/// Waits until `count` subscribers are found; returns how many were.
fn wait_for_subscribers(publisher: &Participant, count: usize) -> usize {
    let start = Instant::now();
    while publisher.subscribers(TOPIC) < count && start.elapsed() < Duration::from_secs(30) {
        std::thread::sleep(Duration::from_millis(10));
    }
    publisher.subscribers(TOPIC)
}

#[test]
fn localhost_participants_of_one_domain_meet_and_others_stay_apart() {
    let mut publishing = open(domain(), DiscoveryRange::Localhost);
    let publisher = publish(&mut publishing).unwrap();
    let mut hidden = open(domain(), DiscoveryRange::Off);
    let _hidden_subscription = subscribe(&mut hidden).unwrap();
    let mut elsewhere = open(domain() + 1, DiscoveryRange::Localhost);
    let _far_subscription = subscribe(&mut elsewhere).unwrap();
    // The one that must be found comes last: by then the others would have been found as well.
    let mut near = open(domain(), DiscoveryRange::Localhost);
    let subscription = subscribe(&mut near).unwrap();

    assert_eq!(wait_for_subscribers(&publishing, 1), 1);
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!((publishing.subscribers(TOPIC), hidden.publishers(TOPIC), elsewhere.publishers(TOPIC)), (1, 0, 0));

    // Both have found each other when a message comes through: repeat it until then.
    let start = Instant::now();
    let received = loop {
        publisher.publish(PoseStamped::default()).unwrap();
        std::thread::sleep(Duration::from_millis(20));
        if let Some((message, _)) = subscription.take().unwrap() {
            break message;
        }
        assert!(start.elapsed() < Duration::from_secs(30), "no message came through");
    };
    assert_eq!(received, PoseStamped::default());
}
