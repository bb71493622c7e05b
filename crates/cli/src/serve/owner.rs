//! The user to whom a connection on this computer belongs.
//!
//! The token alone does not exclude other users: the address is an argument of the program that starts the
//! browser, and every user can read the arguments of all processes. Linux lists the owner of every TCP
//! socket.

use std::net::SocketAddr;

/// True if the client of a connection on the loopback address is known to be another user than that of this
/// process and than root, who can read everything anyway.
///
/// Systems without this list, and sockets that are not in it, count as this user's: there, the token decides.
pub(super) fn is_other_user(client: SocketAddr, server: SocketAddr) -> bool {
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::fs::MetadataExt;
        let Ok(own) = std::fs::metadata("/proc/self").map(|process| process.uid()) else { return false };
        ["/proc/net/tcp", "/proc/net/tcp6"]
            .iter()
            .filter_map(|list| std::fs::read_to_string(list).ok())
            .find_map(|list| owner(&list, client, server))
            .is_some_and(|user| user != own && user != ROOT)
    }
    #[cfg(not(target_os = "linux"))]
    {
        let _ = (client, server);
        false
    }
}

/// Number of the user root. Closed sockets have this number, too; they can no longer receive the page.
#[cfg(any(target_os = "linux", test))]
const ROOT: u32 = 0;

/// The user who owns the socket of a client, according to `/proc/net/tcp` or `/proc/net/tcp6` (see
/// proc_net_tcp in the documentation of the Linux kernel).
#[cfg(any(target_os = "linux", test))]
fn owner(list: &str, client: SocketAddr, server: SocketAddr) -> Option<u32> {
    let (client, server) = (listed(client)?, listed(server)?);
    list.lines().find_map(|line| {
        let mut columns = line.split_ascii_whitespace().skip(1);
        let is_client = columns.next()?.ends_with(&client) && columns.next()?.ends_with(&server);
        is_client.then(|| columns.nth(4)?.parse().ok()).flatten()
    })
}

/// An address as in these lists. IPv6 sockets that reach an IPv4 address have the same last eight digits.
#[cfg(any(target_os = "linux", test))]
fn listed(address: SocketAddr) -> Option<String> {
    match address {
        SocketAddr::V4(address) => {
            // The kernel prints the four bytes as one number of this machine.
            Some(format!("{:08X}:{:04X}", u32::from_ne_bytes(address.ip().octets()), address.port()))
        }
        SocketAddr::V6(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A list as the kernel prints it, with the client's socket, the server's end of it, and another one.
    fn list(client: SocketAddr, server: SocketAddr, prefix: &str) -> String {
        let [client, server] = [client, server].map(|address| listed(address).unwrap());
        let line = |from: &str, to: &str, user: u32| {
            format!(
                "   0: {prefix}{from} {prefix}{to} 01 00000000:00000000 00:00000000 00000000 {user:>5} 0 9\n"
            )
        };
        "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n"
            .to_owned()
            + &line("0100007F:0016", "00000000:0000", 7)
            + &line(&server, &client, 1000)
            + &line(&client, &server, 1001)
    }

    #[test]
    fn the_owner_of_the_clients_end_is_found() {
        let [client, server] = ["127.0.0.1:50000", "127.0.0.1:8080"].map(|text| text.parse().unwrap());
        assert_eq!(owner(&list(client, server, ""), client, server), Some(1001));
        let mapped = list(client, server, "0000000000000000FFFF0000");
        assert_eq!(owner(&mapped, client, server), Some(1001));
        assert_eq!(owner(&list(client, server, ""), "127.0.0.1:50001".parse().unwrap(), server), None);
        for damaged in ["", "x", "  0: 0100007F:C350", "  0: 0100007F:C350 0100007F:1F90 01 0 0 0 x"] {
            assert_eq!(owner(damaged, client, server), None);
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_kernel_lists_own_connections() {
        use std::os::unix::fs::MetadataExt;
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let server = listener.local_addr().unwrap();
        let stream = std::net::TcpStream::connect(server).unwrap();
        let client = stream.local_addr().unwrap();
        let own = std::fs::metadata("/proc/self").unwrap().uid();
        let list = std::fs::read_to_string("/proc/net/tcp").unwrap();
        assert_eq!(owner(&list, client, server), Some(own));
        assert!(!is_other_user(client, server));
    }
}
