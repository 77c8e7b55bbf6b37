//! Sealed answers: written where the diagnosis is never told of, their hashes known before it starts, opened only
//! after it has answered, and checked against those hashes then.

use crate::error::{Error, io};
use sha2::{Digest, Sha256};
use std::path::PathBuf;

/// SHA-256 in hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// A folder of sealed answers.
#[derive(Debug)]
pub struct Vault {
    dir: tempfile::TempDir,
    seals: Vec<Seal>,
}

/// The hash of one answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seal {
    /// Name of the case.
    pub name: String,
    /// SHA-256 of its answer.
    pub hash: String,
}

impl Vault {
    /// A fresh folder that only this user can enter.
    ///
    /// # Errors
    /// If the operating system refuses.
    pub fn new() -> Result<Self, Error> {
        let dir = tempfile::Builder::new().prefix("sealed-").tempdir();
        let dir = dir.map_err(|e| Error::Run(format!("folder for sealed answers: cannot be made: {e}")))?;
        Ok(Self { dir, seals: Vec::new() })
    }

    /// Seals the answer to case `name`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn seal(&mut self, name: &str, answer: &str) -> Result<&Seal, Error> {
        let path = self.path(name);
        std::fs::write(&path, answer).map_err(io("written", &path))?;
        self.seals.push(Seal { name: name.to_owned(), hash: sha256(answer.as_bytes()) });
        self.seals.last().ok_or_else(|| Error::Run("no answer was sealed".to_owned()))
    }

    /// The hashes, in the order of sealing.
    pub fn seals(&self) -> &[Seal] {
        &self.seals
    }

    /// One hash over all of them, to be quoted.
    pub fn digest(&self) -> String {
        sha256(self.seals.iter().map(|s| format!("{}  {}\n", s.hash, s.name)).collect::<String>().as_bytes())
    }

    /// Opens an answer.
    ///
    /// # Errors
    /// If it is not, byte for byte, the one that was sealed.
    pub fn open(&self, name: &str) -> Result<String, Error> {
        let path = self.path(name);
        let text = std::fs::read_to_string(&path).map_err(io("opened", &path))?;
        let found = sha256(text.as_bytes());
        match self.seals.iter().find(|s| s.name == name) {
            Some(seal) if seal.hash == found => Ok(text),
            Some(seal) => {
                Err(Error::Run(format!("{name}: found an answer with hash {found}; sealed was {}", seal.hash)))
            }
            None => Err(Error::Run(format!("{name}: no such answer was sealed"))),
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(format!("{name}.json"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sha256_is_that_of_the_standard() {
        // FIPS 180-4, example 1.
        assert_eq!(sha256(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    #[test]
    fn an_answer_that_was_changed_is_not_opened() {
        let mut vault = Vault::new().unwrap();
        let hash = vault.seal("case_001", "{\"effects\": []}").unwrap().hash.clone();
        assert_eq!(hash, sha256(b"{\"effects\": []}"));
        vault.seal("case_002", "{}").unwrap();
        let before = vault.digest();
        assert_eq!(vault.open("case_001").unwrap(), "{\"effects\": []}");
        std::fs::write(vault.path("case_001"), "{\"effects\": [1]}").unwrap();
        let e = vault.open("case_001").unwrap_err().to_string();
        assert!(e.contains("case_001") && e.contains(&hash), "{e}");
        assert!(vault.open("case_009").is_err());
        assert_eq!(before, vault.digest(), "the digest is of what was sealed");
    }
}
