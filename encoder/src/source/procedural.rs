use crate::*;
pub fn from_name(_name: &str) -> Result<Input> { Err(Error::Argument("x".into())) }
