//! Keeps the participant's sockets to the loopback interface where the discovery range says so.
//!
//! RustDDS (0.15) announces itself, joins groups and sends on the chosen interfaces alone, but it binds its UDP sockets to
//! 0.0.0.0 and has no setting for that. On Linux a socket can be bound to an interface afterwards (`SO_BINDTODEVICE`; since 5.7
//! without any privilege): the kernel then hands it nothing that came by another. What this host sends to itself, by whatever
//! address, comes by loopback.

use socket2::{Domain, SockRef, Type};
use std::io::{Error, Result};
use std::os::fd::BorrowedFd;

/// Linux' name of it.
const LOOPBACK: &[u8] = b"lo";

/// Binds all UDP sockets of this process to loopback; gives how many there are. The bridge's process has none but DDS's.
pub(crate) fn keep_to_loopback() -> Result<usize> {
    let sockets = udp_sockets()?;
    for number in &sockets {
        with_socket(*number, |socket| match socket.device()? {
            Some(device) if device == LOOPBACK => Ok(()),
            _ => socket.bind_device(Some(LOOPBACK)),
        })?;
    }
    Ok(sockets.len())
}

/// File descriptors of this process's UDP sockets of IPv4, the only kind that RustDDS listens with.
fn udp_sockets() -> Result<Vec<i32>> {
    let numbers = std::fs::read_dir("/proc/self/fd")?.flatten();
    let numbers = numbers.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let is_udp = |number: &i32| {
        let kind = with_socket(*number, |socket| Ok((socket.domain()?, socket.r#type()?)));
        kind.is_ok_and(|kind| kind == (Domain::IPV4, Type::DGRAM))
    };
    Ok(numbers.filter(is_udp).collect())
}

/// Port and interface of each.
#[cfg(test)]
pub(crate) fn ports() -> Vec<(u16, Option<Vec<u8>>)> {
    let port = |socket: &SockRef<'_>| -> Result<u16> {
        Ok(socket.local_addr()?.as_socket_ipv4().map_or(0, |address| address.port()))
    };
    let of = |number| with_socket(number, |socket| Ok((port(socket)?, socket.device()?))).ok();
    udp_sockets().unwrap_or_default().into_iter().filter_map(of).collect()
}

/// Asks something of a file descriptor as if it were a socket; one that is none, or is closed by now, answers with an error.
fn with_socket<T>(number: i32, ask: impl FnOnce(&SockRef<'_>) -> Result<T>) -> Result<T> {
    if number < 0 {
        return Err(Error::from(std::io::ErrorKind::InvalidInput));
    }
    // SAFETY: not -1, and used for system calls within this function alone, none of which touches memory behind it. Were it closed
    // by another thread in between, the calls fail; were it another socket by then, it is one of this process, too.
    let socket = unsafe { BorrowedFd::borrow_raw(number) };
    ask(&SockRef::from(&socket))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::UdpSocket;
    use std::os::fd::AsRawFd;

    #[test]
    fn sockets_are_found_and_kept_to_loopback_and_still_hear_this_host() {
        let socket = UdpSocket::bind("0.0.0.0:0").unwrap();
        let file = std::fs::File::open("/proc/self/status").unwrap();
        let found = udp_sockets().unwrap();
        assert!(found.contains(&socket.as_raw_fd()) && !found.contains(&file.as_raw_fd()));
        assert!(keep_to_loopback().unwrap() >= 1);
        assert_eq!(SockRef::from(&socket).device().unwrap().as_deref(), Some(LOOPBACK));
        let port = socket.local_addr().unwrap().port();
        UdpSocket::bind("127.0.0.1:0").unwrap().send_to(b"here", ("127.0.0.1", port)).unwrap();
        let mut bytes = [0; 8];
        socket.set_read_timeout(Some(std::time::Duration::from_secs(30))).unwrap();
        assert_eq!(socket.recv(&mut bytes).unwrap(), 4);
    }
}
