//! One connection: reads a request, sends the response, and waits for the client to close.

use super::response::{Response, Status};
use super::{Limits, Site, owner, request};
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::time::{Duration, Instant};

/// Maximum number of bytes that one connection moves per round, so that a fast client does not delay others.
const BYTES_PER_ROUND: usize = 1 << 20;

/// What a round did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// Nothing: the client is awaited.
    Waiting,
    /// Bytes moved, or the connection ended.
    Moved,
    /// The page was sent completely.
    PageSent,
}

/// A connection.
pub(super) struct Connection<'a> {
    stream: TcpStream,
    peer: SocketAddr,
    stage: Stage<'a>,
    /// End of the time for this stage.
    deadline: Instant,
}

enum Stage<'a> {
    /// The request arrives.
    Reading(Vec<u8>),
    /// The response is sent.
    Writing(Response<'a>),
    /// The response was sent. What the client still sends is discarded: closing a connection with unread data
    /// would reset it, and the client could lose the end of the response (RFC 9112, section 9.6).
    Closing,
    Closed,
}

impl<'a> Connection<'a> {
    /// Takes over an accepted connection.
    ///
    /// # Errors
    /// The error of the system; the connection is then unusable.
    pub fn new(stream: TcpStream, peer: SocketAddr, limits: &Limits) -> std::io::Result<Self> {
        // On some systems a stream inherits the mode of its listener, on others it does not.
        stream.set_nonblocking(true)?;
        Ok(Self {
            stream,
            peer,
            stage: Stage::Reading(Vec::new()),
            deadline: Instant::now() + limits.header_time,
        })
    }

    /// True while the page is being sent.
    pub fn sends_the_page(&self) -> bool {
        matches!(&self.stage, Stage::Writing(response) if response.is_page())
    }

    /// True if the connection has ended.
    pub fn is_closed(&self) -> bool {
        matches!(self.stage, Stage::Closed)
    }

    /// Moves as many bytes as possible without waiting.
    pub fn advance(&mut self, site: &Site<'a>, now: Instant) -> Step {
        let step = match self.stage {
            Stage::Reading(_) => self.read(site, now),
            Stage::Writing(_) => self.write(site, now),
            Stage::Closing => self.discard(),
            Stage::Closed => Ok(Step::Moved),
        };
        // A broken connection is the client's problem; the server goes on.
        let step = step.unwrap_or_else(|_| {
            self.stage = Stage::Closed;
            Step::Moved
        });
        // The time also ends for clients that send or read a byte now and then. A new stage has a new
        // deadline.
        if now >= self.deadline {
            self.expire(site, now);
        }
        step
    }

    /// Reads the header, and begins the response at its end.
    fn read(&mut self, site: &Site<'a>, now: Instant) -> std::io::Result<Step> {
        let Stage::Reading(received) = &mut self.stage else { return Ok(Step::Waiting) };
        let mut part = [0; 4096];
        let count = match receive(&mut self.stream, &mut part)? {
            None => return Ok(Step::Waiting),
            // Without a complete header there is nothing to answer.
            Some(0) => {
                self.stage = Stage::Closed;
                return Ok(Step::Moved);
            }
            Some(count) => count,
        };
        // The empty line has at most three bytes with the line end before it; two of them can have arrived
        // before.
        let old = received.len().saturating_sub(2);
        received.extend_from_slice(&part[..count]);
        if old == 0 {
            received.drain(..request::leading_empty_lines(received));
        }
        match request::header_end(received, old) {
            Some(end) if end <= site.limits.header_bytes => {
                let mut decision = request::decide(&received[..end], site.token, site.address.port());
                if decision.status == Status::Ok && owner::is_other_user(self.peer, site.address) {
                    decision.status = Status::NotFound;
                }
                self.respond(decision.status, decision.is_head, site, now);
            }
            None if received.len() <= site.limits.header_bytes => {
                // Other protocols, such as TLS, would wait for an answer until the time is over.
                if received.first().is_some_and(|first| !first.is_ascii_alphabetic()) {
                    self.respond(Status::BadRequest, false, site, now);
                }
            }
            _ => self.respond(Status::HeaderTooLarge, false, site, now),
        }
        Ok(Step::Moved)
    }

    fn respond(&mut self, status: Status, is_head: bool, site: &Site<'a>, now: Instant) {
        let response = Response::new(status, site.page, is_head);
        let transfer = Duration::from_secs((response.len() / site.limits.bytes_per_second) as u64);
        self.deadline = now + site.limits.response_time + transfer;
        self.stage = Stage::Writing(response);
    }

    fn write(&mut self, site: &Site<'a>, now: Instant) -> std::io::Result<Step> {
        let Stage::Writing(response) = &mut self.stage else { return Ok(Step::Waiting) };
        let mut moved = 0;
        while !response.rest().is_empty() && moved < BYTES_PER_ROUND {
            match self.stream.write(response.rest()) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => {
                    response.advance(count);
                    moved += count;
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        if !response.rest().is_empty() {
            return Ok(if moved > 0 { Step::Moved } else { Step::Waiting });
        }
        let step = if response.is_page() { Step::PageSent } else { Step::Moved };
        self.stage = Stage::Closing;
        self.deadline = now + site.limits.close_time;
        // The client sees the end of the response even if it does not read the length. An error here means
        // that it has closed the connection already; the next read notices that.
        let _ = self.stream.shutdown(Shutdown::Write);
        Ok(step)
    }

    fn discard(&mut self) -> std::io::Result<Step> {
        let mut part = [0; 64 * 1024];
        match receive(&mut self.stream, &mut part)? {
            None => Ok(Step::Waiting),
            Some(0) => {
                self.stage = Stage::Closed;
                Ok(Step::Moved)
            }
            Some(_) => Ok(Step::Moved),
        }
    }

    /// Ends a stage whose time is over.
    fn expire(&mut self, site: &Site<'a>, now: Instant) {
        match &self.stage {
            Stage::Reading(received) if !received.is_empty() => {
                self.respond(Status::RequestTimeout, false, site, now);
            }
            // Browsers open connections in advance; they expect no response on one without a request.
            _ => self.stage = Stage::Closed,
        }
    }
}

/// Reads without waiting; `None` if nothing has arrived, and 0 at the end of the stream.
fn receive(stream: &mut TcpStream, part: &mut [u8]) -> std::io::Result<Option<usize>> {
    match stream.read(part) {
        Ok(count) => Ok(Some(count)),
        Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(None),
        Err(e) => Err(e),
    }
}
