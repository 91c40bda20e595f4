//! The environment variables by which ROS 2 sets up discovery. ros2-client reads none of them.

use crate::BridgeError;
use std::net::{IpAddr, Ipv4Addr};

/// The highest domain whose first participants' ports fit into 16 bits (DDSI-RTPS 9.6.1.1: 7400 + 250 d).
const MAX_DOMAIN_ID: u16 = 232;

/// Whom the participant may find by itself (`ROS_AUTOMATIC_DISCOVERY_RANGE`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DiscoveryRange {
    /// Nobody, not even on this host.
    Off,
    /// Participants on this host, over 127.0.0.1.
    Localhost,
    /// Whoever multicast reaches on the networks of this host; ROS 2's default.
    Subnet,
    /// What the middleware does by itself: for RustDDS the same as `Subnet`.
    SystemDefault,
}

impl DiscoveryRange {
    /// Whether nobody beyond this host is to be heard.
    #[must_use]
    pub fn is_this_host(self) -> bool {
        matches!(self, Self::Off | Self::Localhost)
    }

    /// The addresses whose interfaces may be used; `None` for all.
    #[must_use]
    pub fn only_networks(self) -> Option<Vec<IpAddr>> {
        match self {
            Self::Off => Some(Vec::new()),
            Self::Localhost => Some(vec![IpAddr::V4(Ipv4Addr::LOCALHOST)]),
            Self::Subnet | Self::SystemDefault => None,
        }
    }
}

/// What the environment says about DDS.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DdsEnvironment {
    /// `ROS_DOMAIN_ID`, 0..=232; 0 where it is not set.
    pub domain_id: u16,
    /// `ROS_LOCALHOST_ONLY` and `ROS_AUTOMATIC_DISCOVERY_RANGE` together; the former wins, as in rcl.
    pub range: DiscoveryRange,
    /// `RMW_IMPLEMENTATION`: what the other nodes of this shell speak.
    pub middleware: Option<String>,
}

/// Variables by which ROS 2's middlewares are set up, and why they change nothing here.
const NOT_HONOURED: [(&str, &str); 5] = [
    ("ROS_STATIC_PEERS", "RustDDS finds peers by multicast and on this host only"),
    ("CYCLONEDDS_URI", "it configures CycloneDDS, this is RustDDS"),
    ("FASTRTPS_DEFAULT_PROFILES_FILE", "it configures Fast DDS, this is RustDDS"),
    ("FASTDDS_DEFAULT_PROFILES_FILE", "it configures Fast DDS, this is RustDDS"),
    ("ROS_DISCOVERY_SERVER", "RustDDS knows no discovery server"),
];

/// An environment variable without meaning.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("environment variable {variable}={value}: set it to {remedy}, or unset it")]
pub struct EnvironmentError {
    variable: &'static str,
    value: String,
    remedy: &'static str,
}

impl DdsEnvironment {
    /// Reads the environment of this process.
    ///
    /// # Errors
    /// When a variable holds something that ROS 2 gives no meaning.
    pub fn of_process() -> Result<Self, EnvironmentError> {
        Self::read(|name| std::env::var_os(name).map(|value| value.to_string_lossy().into_owned()))
    }

    /// Reads variables from wherever they are. An empty variable counts as unset.
    ///
    /// # Errors
    /// When a variable holds something that ROS 2 gives no meaning.
    pub fn read(variable: impl Fn(&str) -> Option<String>) -> Result<Self, EnvironmentError> {
        let get = |name: &str| variable(name).filter(|value| !value.is_empty());
        let domain_id = get("ROS_DOMAIN_ID").map_or(Ok(0), domain_id)?;
        let localhost_only = get("ROS_LOCALHOST_ONLY").map_or(Ok(false), localhost_only)?;
        let range = get("ROS_AUTOMATIC_DISCOVERY_RANGE").map_or(Ok(DiscoveryRange::Subnet), range)?;
        let range = if localhost_only { DiscoveryRange::Localhost } else { range };
        Ok(Self { domain_id, range, middleware: get("RMW_IMPLEMENTATION") })
    }

    /// One line for each variable that is set and changes nothing.
    #[must_use]
    pub fn not_honoured(variable: impl Fn(&str) -> Option<String>) -> Vec<String> {
        let set = NOT_HONOURED.iter().filter(|(name, _)| variable(name).is_some_and(|value| !value.is_empty()));
        set.map(|(name, why)| format!("{name} is not honoured: {why}")).collect()
    }

    /// What is wrong with `ROS_DISTRO`, if anything: nodes of other releases hear the messages, but cannot list the topics of ours.
    #[must_use]
    pub fn other_release(distro: Option<&str>) -> Option<String> {
        // Iron has the same node graph.
        const SINCE_JAZZY: [&str; 5] = ["iron", "jazzy", "kilted", "lyrical", "rolling"];
        let distro = distro.filter(|distro| !distro.is_empty())?;
        let fits = if cfg!(feature = "jazzy") { SINCE_JAZZY.contains(&distro) } else { distro == "humble" };
        let built = if cfg!(feature = "jazzy") { "Jazzy and later" } else { "Humble" };
        (!fits).then(|| {
            format!(
                "ROS_DISTRO={distro}, but this build speaks the node graph of {built}: `ros2 topic list` may not show it \
                 (features `jazzy`, `humble`)"
            )
        })
    }

    /// Whether the nodes of this shell can hear DDS; a line for the log where they cannot, but that is `allowed`.
    ///
    /// # Errors
    /// When they speak Zenoh, unless that is `allowed`.
    pub fn check_middleware(&self, allowed: bool) -> Result<Option<String>, BridgeError> {
        match &self.middleware {
            Some(name) if name.contains("zenoh") && !allowed => Err(BridgeError::Middleware(name.clone())),
            Some(name) if name.contains("zenoh") => {
                Ok(Some(format!("RMW_IMPLEMENTATION={name}: its nodes do not hear DDS, which is spoken here")))
            }
            _ => Ok(None),
        }
    }
}

fn domain_id(value: String) -> Result<u16, EnvironmentError> {
    match value.parse() {
        Ok(id) if id <= MAX_DOMAIN_ID => Ok(id),
        _ => Err(EnvironmentError { variable: "ROS_DOMAIN_ID", value, remedy: "a whole number from 0 to 232" }),
    }
}

fn localhost_only(value: String) -> Result<bool, EnvironmentError> {
    match value.as_str() {
        "0" => Ok(false),
        "1" => Ok(true),
        _ => Err(EnvironmentError { variable: "ROS_LOCALHOST_ONLY", value, remedy: "0 or 1" }),
    }
}

fn range(value: String) -> Result<DiscoveryRange, EnvironmentError> {
    match value.as_str() {
        "OFF" => Ok(DiscoveryRange::Off),
        "LOCALHOST" => Ok(DiscoveryRange::Localhost),
        "SUBNET" => Ok(DiscoveryRange::Subnet),
        "SYSTEM_DEFAULT" => Ok(DiscoveryRange::SystemDefault),
        _ => Err(EnvironmentError {
            variable: "ROS_AUTOMATIC_DISCOVERY_RANGE",
            value,
            remedy: "OFF, LOCALHOST, SUBNET or SYSTEM_DEFAULT",
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(variables: &[(&str, &str)]) -> Result<DdsEnvironment, EnvironmentError> {
        DdsEnvironment::read(|name| variables.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).into()))
    }

    #[test]
    fn nothing_set_is_domain_zero_on_the_subnet() {
        let expected = DdsEnvironment { domain_id: 0, range: DiscoveryRange::Subnet, middleware: None };
        assert_eq!(read(&[]).unwrap(), expected);
        assert_eq!(read(&[("ROS_DOMAIN_ID", ""), ("ROS_LOCALHOST_ONLY", "")]).unwrap(), expected);
    }

    #[test]
    fn each_variable_is_honoured() {
        let all = [("ROS_DOMAIN_ID", "42"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")];
        assert_eq!(read(&all).unwrap(), DdsEnvironment { domain_id: 42, range: DiscoveryRange::Off, middleware: None });
        for (name, range) in [
            ("LOCALHOST", DiscoveryRange::Localhost),
            ("SUBNET", DiscoveryRange::Subnet),
            ("SYSTEM_DEFAULT", DiscoveryRange::SystemDefault),
        ] {
            assert_eq!(read(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", name)]).unwrap().range, range);
        }
    }

    #[test]
    fn localhost_only_wins_when_it_is_1() {
        let with = |flag| read(&[("ROS_LOCALHOST_ONLY", flag), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")]);
        assert_eq!(with("1").unwrap().range, DiscoveryRange::Localhost);
        assert_eq!(with("0").unwrap().range, DiscoveryRange::Off);
    }

    #[test]
    fn zenoh_is_refused_with_the_reason_and_what_changes_nothing_is_named() {
        let zenoh = read(&[("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")]).unwrap();
        let text = zenoh.check_middleware(false).unwrap_err().to_string();
        assert!(text.contains("rmw_zenoh_cpp") && text.contains("--allow-rmw-mismatch"), "{text}");
        assert!(zenoh.check_middleware(true).unwrap().unwrap().contains("rmw_zenoh_cpp"));
        let cyclone = read(&[("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")]).unwrap();
        assert_eq!(cyclone.check_middleware(false).unwrap(), None);
        let lines = DdsEnvironment::not_honoured(|name| (name != "CYCLONEDDS_URI").then(|| "x".to_owned()));
        assert_eq!(lines.len(), 4);
        assert!(lines[0].starts_with("ROS_STATIC_PEERS is not honoured"));
    }

    #[test]
    #[cfg(feature = "jazzy")]
    fn later_releases_are_no_error() {
        for distro in [None, Some(""), Some("jazzy"), Some("kilted"), Some("lyrical"), Some("rolling")] {
            assert_eq!(DdsEnvironment::other_release(distro), None);
        }
        assert!(DdsEnvironment::other_release(Some("humble")).unwrap().contains("humble"));
    }

    #[test]
    fn ranges_name_their_networks() {
        assert_eq!(DiscoveryRange::Off.only_networks(), Some(vec![]));
        assert_eq!(DiscoveryRange::Localhost.only_networks(), Some(vec!["127.0.0.1".parse().unwrap()]));
        assert_eq!(DiscoveryRange::Subnet.only_networks(), None);
    }

    #[test]
    fn nonsense_is_refused_with_name_value_and_remedy() {
        for (name, value) in [
            ("ROS_DOMAIN_ID", "233"),
            ("ROS_DOMAIN_ID", "-1"),
            ("ROS_DOMAIN_ID", "zero"),
            ("ROS_LOCALHOST_ONLY", "yes"),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "subnet"),
        ] {
            let text = read(&[(name, value)]).unwrap_err().to_string();
            assert!(text.contains(name) && text.contains(value) && text.contains("set it to"), "{text}");
        }
    }
}
