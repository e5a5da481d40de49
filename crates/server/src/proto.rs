//! The gRPC interface's messages, client and server, generated from
//! `proto/densecloud/v1/densecloud.proto`, where all of it is described.
#![allow(missing_docs, unreachable_pub, clippy::all, reason = "generated")]

tonic::include_proto!("densecloud.v1");

/// The contract itself, for reflection: an encoded `google.protobuf.FileDescriptorSet`.
pub const DESCRIPTOR: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/densecloud.bin"));
