//! Where the database is, and how it is reached.

use std::fmt;
use std::path::PathBuf;

use tokio_postgres::config::SslMode;
use url::Url;

const PORT: u16 = 5432;
/// Of the schema, where the address names none.
const SCHEMA: &str = "densecloud";

/// Where a Postgres database is: `postgres://user@host:port/database?sslmode=verify-full&sslrootcert=file`, or
/// `postgres:///database?host=/folder&user=user&port=port` for the socket in a folder of this machine.
///
/// | option | says |
/// |---|---|
/// | `sslmode` | `verify-full`, which is so without it: TLS, and the server shows that it is the host; or `disable` |
/// | `sslrootcert` | a PEM file with whom to believe that, in place of those whom the system believes |
/// | `host`, `user`, `port` | the folder of the server's socket, and what stands beside the host elsewhere |
/// | `schema` | the name of the schema of densecloud's tables, `densecloud` without it |
///
/// There is no password in it: see [`Password`](super::Password).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Address {
    pub(super) host: Host,
    pub(super) user: String,
    pub(super) database: String,
    pub(super) schema: String,
}

/// The server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Host {
    Network { name: String, port: u16, tls: Option<Roots> },
    Socket { folder: PathBuf, port: u16 },
}

/// Who is believed that a server is who it says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Roots {
    System,
    File(PathBuf),
}

/// What is wrong with an address. It repeats nothing of it, since a password may be in it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the address of the database {0}")]
pub struct AddressError(String);

fn wrong<T>(what: impl Into<String>) -> Result<T, AddressError> {
    Err(AddressError(what.into()))
}

/// The options of an address, each at most once.
#[derive(Default)]
struct Options {
    sslmode: Option<String>,
    sslrootcert: Option<String>,
    host: Option<String>,
    user: Option<String>,
    port: Option<String>,
    schema: Option<String>,
}

impl Options {
    fn of(url: &Url) -> Result<Self, AddressError> {
        let mut options = Self::default();
        for (name, value) in url.query_pairs() {
            let place = match &*name {
                "sslmode" => &mut options.sslmode,
                "sslrootcert" => &mut options.sslrootcert,
                "host" => &mut options.host,
                "user" => &mut options.user,
                "port" => &mut options.port,
                "schema" => &mut options.schema,
                "password" | "sslpassword" => return wrong("must not have a password in it"),
                _ => {
                    return wrong(
                        "has an option other than sslmode, sslrootcert, host, user, port and schema",
                    );
                }
            };
            if place.replace(value.into_owned()).is_some() {
                return wrong(format!("has {name} twice"));
            }
        }
        Ok(options)
    }

    /// For a server of the network.
    fn tls(&self) -> Result<Option<Roots>, AddressError> {
        let file = self.sslrootcert.as_ref().filter(|file| *file != "system");
        match self.sslmode.as_deref() {
            None | Some("verify-full") => {
                Ok(Some(file.map_or(Roots::System, |file| Roots::File(file.into()))))
            }
            Some("disable") if self.sslrootcert.is_some() => {
                wrong("has sslrootcert, and no TLS to use it for")
            }
            Some("disable") => Ok(None),
            Some(_) => {
                wrong("has an sslmode other than verify-full and disable: any other trusts whoever answers")
            }
        }
    }
}

impl Address {
    /// # Errors
    /// What is wrong with it: whatever is not understood is refused.
    pub fn parse(text: &str) -> Result<Self, AddressError> {
        let Ok(url) = Url::parse(text) else {
            return wrong("is not of the form postgres://user@host/database");
        };
        if !matches!(url.scheme(), "postgres" | "postgresql") || url.fragment().is_some() {
            return wrong("is not of the form postgres://user@host/database");
        }
        if url.password().is_some() {
            return wrong("must not have a password in it");
        }
        let mut options = Options::of(&url)?;
        Ok(Self {
            host: Host::of(&url, &options)?,
            user: part("user", options.user.as_deref().unwrap_or(url.username()))?,
            database: part("database", url.path().strip_prefix('/').unwrap_or_default())?,
            schema: schema(options.schema.take())?,
        })
    }

    /// As the client library has it, without a password.
    pub(super) fn config(&self) -> tokio_postgres::Config {
        let mut config = tokio_postgres::Config::new();
        config.user(&self.user).dbname(&self.database).application_name("densecloud");
        match &self.host {
            Host::Network { name, port, tls } => {
                config.host(name).port(*port);
                config.ssl_mode(if tls.is_some() { SslMode::Require } else { SslMode::Disable })
            }
            #[cfg(unix)]
            Host::Socket { folder, port } => config.host_path(folder).port(*port).ssl_mode(SslMode::Disable),
            // Refused when the address was read.
            #[cfg(not(unix))]
            Host::Socket { .. } => &mut config,
        };
        config
    }
}

impl Host {
    fn of(url: &Url, options: &Options) -> Result<Self, AddressError> {
        match (url.host_str().filter(|host| !host.is_empty()), &options.host) {
            (Some(_), Some(_)) => wrong("names two hosts"),
            (Some(_), None) if options.port.is_some() || options.user.is_some() => {
                wrong("has a user or a port among its options; they go beside its host")
            }
            (Some(name), None) => {
                let name = part("host", name.trim_start_matches('[').trim_end_matches(']'))?;
                if name.contains(',') {
                    return wrong("names more than one host; give it that of the server that takes changes");
                }
                // The library would take it for a folder.
                if name.contains('/') {
                    return wrong("names a host with a / in it");
                }
                Ok(Self::Network { name, port: url.port().unwrap_or(PORT), tls: options.tls()? })
            }
            (None, Some(folder)) if folder.starts_with('/') => Self::socket(folder, options),
            (None, Some(_)) => {
                wrong("has a host that is no folder's whole path; others go before the database's name")
            }
            (None, None) => wrong("names no host"),
        }
    }

    fn socket(folder: &str, options: &Options) -> Result<Self, AddressError> {
        if options.sslmode.as_ref().is_some_and(|mode| mode != "disable") || options.sslrootcert.is_some() {
            return wrong("asks for TLS, which there is none on a socket of this machine");
        }
        match options.port.as_ref().map_or(Ok(PORT), |port| port.parse()) {
            Ok(_) if cfg!(not(unix)) => wrong("names a folder of sockets, which this system has none of"),
            Ok(port) => Ok(Self::Socket { folder: folder.into(), port }),
            Err(_) => wrong("has a port that is no number"),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { host, user, database, schema } = self;
        match host {
            Host::Network { name, port, .. } => write!(f, "postgres://{user}@{name}:{port}/{database}")?,
            Host::Socket { folder, port } => {
                write!(f, "postgres:///{database}?host={}&user={user}&port={port}", folder.display())?;
            }
        }
        write!(f, " (schema {schema})")
    }
}

/// A part that must be there, its escapes undone.
fn part(name: &str, text: &str) -> Result<String, AddressError> {
    let pair = format!("x={}", text.replace('+', "%2B").replace('&', "%26"));
    let decoded = url::form_urlencoded::parse(pair.as_bytes()).next().map(|(_, value)| value.into_owned());
    match decoded.filter(|text| !text.is_empty()) {
        Some(text) if !text.contains('\0') => Ok(text),
        _ => wrong(format!("names no {name}")),
    }
}

/// Names that need no quotes: nothing else in a statement is from outside.
fn schema(name: Option<String>) -> Result<String, AddressError> {
    let name = name.unwrap_or_else(|| SCHEMA.to_owned());
    let begins = name.starts_with(|c: char| c.is_ascii_lowercase() || c == '_');
    let plain = name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    if begins && plain && name.len() <= 48 && !name.starts_with("pg_") {
        return Ok(name);
    }
    wrong("has a schema that is not of small letters, digits and _, 48 at most, and none of pg_'s")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_says_where_the_database_is() {
        let address =
            Address::parse("postgres://an%40other@db.example:6432/jobs?sslrootcert=/ca.pem&schema=dense_2");
        let address = address.expect("an address");
        let tls = Some(Roots::File("/ca.pem".into()));
        assert_eq!(address.host, Host::Network { name: "db.example".into(), port: 6432, tls });
        assert_eq!((&*address.user, &*address.database, &*address.schema), ("an@other", "jobs", "dense_2"));
        let tls = |text: &str| match Address::parse(text).expect("an address").host {
            Host::Network { tls, .. } => tls,
            Host::Socket { .. } => panic!("of the network"),
        };
        assert_eq!(tls("postgresql://u@h/d"), Some(Roots::System));
        assert_eq!(tls("postgres://u@[::1]/d?sslmode=verify-full&sslrootcert=system"), Some(Roots::System));
        assert_eq!(tls("postgres://u@h/d?sslmode=disable"), None);
        let socket =
            Address::parse("postgres:///d?host=/run/postgresql&user=u&port=5433").expect("an address");
        assert_eq!(socket.host, Host::Socket { folder: "/run/postgresql".into(), port: 5433 });
        assert_eq!(socket.schema, "densecloud");
    }

    #[test]
    fn an_address_that_is_not_understood_is_refused_and_not_repeated() {
        for (text, why) in [
            ("mysql://u:secret@h/d", "form"),
            ("secret", "form"),
            ("postgres://u:secret@h/d", "password"),
            ("postgres://u@h/d?password=secret", "password"),
            ("postgres://h/d", "user"),
            ("postgres://u@h/", "database"),
            ("postgres:///d?user=u", "no host"),
            ("postgres://u@%2Frun/d", "host"),
            ("postgres://u@h,secret/d", "more than one host"),
            ("postgres://u@h/d?port=1", "beside"),
            ("postgres://u@h/d?host=/run", "two hosts"),
            ("postgres:///d?host=secret&user=u", "folder"),
            ("postgres:///d?host=/run&user=u&port=secret", "port"),
            ("postgres:///d?host=/run", "user"),
            ("postgres://u@h/d?sslmode=prefer", "verify-full"),
            ("postgres://u@h/d?sslmode=require", "verify-full"),
            ("postgres://u@h/d?sslmode=disable&sslrootcert=/ca.pem", "no TLS"),
            ("postgres:///d?host=/run&user=u&sslmode=verify-full", "TLS"),
            ("postgres://u@h/d?secret=1", "other than"),
            ("postgres://u@h/d?schema=a&schema=b", "twice"),
            ("postgres://u@h/d?schema=a;b", "schema"),
            ("postgres://u@h/d?schema=pg_catalog", "schema"),
            ("postgres://u@h/d#secret", "form"),
        ] {
            let error = Address::parse(text).expect_err(text).to_string();
            assert!(error.contains(why), "{text}: {error}");
            assert!(!error.contains("secret"), "{error}");
        }
    }
}
