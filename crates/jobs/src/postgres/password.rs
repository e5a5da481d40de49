//! What is said to the database to be let in.

use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use super::Address;
use super::address::Host;

/// A password, which is shown to nobody but the database.
#[derive(Clone, PartialEq, Eq)]
pub struct Password(String);

impl Password {
    /// The first line of a file, which nobody else should be able to read.
    ///
    /// # Errors
    /// The file cannot be read, is empty, or can be read by everybody.
    pub fn from_file(path: &Path) -> io::Result<Self> {
        let text = private(path)?;
        match text.lines().next().filter(|line| !line.is_empty()) {
            Some(line) => Ok(Self(line.to_owned())),
            None => Err(io::Error::other("there is no password in it")),
        }
    }

    /// As Postgres' own programs have it: `PGPASSWORD`, or the line for the address in the file that `PGPASSFILE`
    /// names. None where neither says one: the server may know its clients otherwise.
    ///
    /// # Errors
    /// As [`Password::from_file`], of the second.
    pub fn from_environment(address: &Address) -> io::Result<Option<Self>> {
        if let Some(password) = std::env::var("PGPASSWORD").ok().filter(|text| !text.is_empty()) {
            return Ok(Some(Self(password)));
        }
        match std::env::var_os("PGPASSFILE") {
            Some(file) => Ok(find(&private(Path::new(&file))?, address)),
            None => Ok(None),
        }
    }

    pub(super) fn reveal(&self) -> &str {
        &self.0
    }
}

impl From<String> for Password {
    fn from(text: String) -> Self {
        Self(text)
    }
}

impl fmt::Debug for Password {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a password")
    }
}

/// The text of a file that is not everybody's to read.
fn private(path: &Path) -> io::Result<String> {
    let mut file = File::open(path)?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        if file.metadata()?.permissions().mode() & 0o007 != 0 {
            return Err(io::Error::new(
                io::ErrorKind::PermissionDenied,
                "everybody can read it; chmod 600 is enough",
            ));
        }
    }
    let mut text = String::new();
    file.read_to_string(&mut text)?;
    Ok(text)
}

/// Of the first line `host:port:database:user:password` that fits, where `*` fits all.
fn find(text: &str, address: &Address) -> Option<Password> {
    let (host, port) = match &address.host {
        Host::Network { name, port, .. } => (name.clone(), *port),
        Host::Socket { folder, port } => (folder.to_string_lossy().into_owned(), *port),
    };
    let wanted = [host, port.to_string(), address.database.clone(), address.user.clone()];
    text.lines().filter(|line| !line.starts_with('#')).find_map(|line| {
        let fields = fields(line);
        let fits = |(field, wanted): (&String, &String)| field == "*" || field == wanted;
        (fields.len() == 5 && fields.iter().zip(&wanted).all(fits)).then(|| Password(fields[4].clone()))
    })
}

/// `\` makes the next a letter like any other.
fn fields(line: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut letters = line.chars();
    while let Some(letter) = letters.next() {
        match letter {
            ':' if fields.len() < 5 => fields.push(String::new()),
            '\\' => fields.last_mut().into_iter().for_each(|field| field.extend(letters.next())),
            letter => fields.last_mut().into_iter().for_each(|field| field.push(letter)),
        }
    }
    fields
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_of_an_address_has_its_password() {
        let text = "# postgres\nh:5432:other:u:wrong\nh:*:d:u:a\\:b:c\n*:*:*:*:any\n";
        let of = |address: &str| {
            let found = find(text, &Address::parse(address).expect("an address"));
            found.map(|password| password.reveal().to_owned())
        };
        assert_eq!(of("postgres://u@h/d").as_deref(), Some("a:b:c"));
        assert_eq!(of("postgres://v@h/d").as_deref(), Some("any"));
        assert_eq!(find("h:5432:d:u", &Address::parse("postgres://u@h/d").expect("an address")), None);
    }

    #[cfg(unix)]
    #[test]
    fn a_password_is_read_from_a_file_that_is_not_everybodys_and_never_shown() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().expect("a folder");
        let path = dir.path().join("password");
        std::fs::write(&path, "secret\n").expect("a file");
        let mode = |mode| std::fs::set_permissions(&path, PermissionsExt::from_mode(mode)).expect("a mode");
        mode(0o644);
        let error = Password::from_file(&path).expect_err("everybody's").to_string();
        assert!(error.contains("chmod") && !error.contains("secret"), "{error}");
        mode(0o640);
        let password = Password::from_file(&path).expect("a password");
        assert_eq!(password.reveal(), "secret");
        assert_eq!(format!("{password:?}"), "a password");
        std::fs::write(&path, "\n").expect("a file");
        assert!(Password::from_file(&path).is_err());
    }
}
