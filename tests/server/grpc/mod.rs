//! The gRPC interface, with the client that is generated from the same contract.

mod answers;
mod departures;
mod services;
mod tiles;

use densecloud_cloud::{Attribute, Cloud, Origin, Values};
use densecloud_formats::{CloudReader, Format, Limits, Scalar};
use densecloud_server::proto::options::Goal;
use densecloud_server::proto::upsample_request::Message as In;
use densecloud_server::proto::upsample_response::Message as Out;
use densecloud_server::proto::upsampler_client::UpsamplerClient;
use densecloud_server::proto::{
    Field, Layout, NumberType, Options, PointChunk, Progress, ResultHeader, Start, UpsampleRequest,
};
use futures::stream::{self, Stream, StreamExt};
use tonic::Status;
use tonic::transport::{Channel, Endpoint};

use crate::support::{Server, cloud};

fn channel(server: &Server) -> Channel {
    Endpoint::from_shared(format!("http://{}", server.address)).unwrap().connect_lazy()
}

fn client(server: &Server) -> UpsamplerClient<Channel> {
    UpsamplerClient::new(channel(server))
}

fn message(message: In) -> UpsampleRequest {
    UpsampleRequest { message: Some(message) }
}

fn ratio(ratio: f64) -> Options {
    Options { goal: Some(Goal::Ratio(ratio)), ..Options::default() }
}

/// A file in pieces of `size` bytes.
fn file(options: Options, bytes: &[u8], size: usize) -> Vec<UpsampleRequest> {
    let start = Start { options: Some(options), layout: None };
    let chunks = bytes.chunks(size).map(|piece| message(In::FileChunk(piece.to_vec().into())));
    std::iter::once(message(In::Start(start))).chain(chunks).collect()
}

fn kind(values: &Values) -> NumberType {
    match values {
        Values::U8(_) => NumberType::Uint8,
        Values::I32(_) => NumberType::Int32,
        Values::U32(_) => NumberType::Uint32,
        Values::F32(_) => NumberType::Float32,
        other => panic!("no test has {other:?}"),
    }
}

fn layout(cloud: &Cloud, position_type: NumberType) -> Layout {
    let field = |a: &Attribute| Field { name: a.name.clone(), r#type: kind(&a.values).into() };
    Layout {
        points: cloud.positions.len() as u64,
        position_type: position_type.into(),
        fields: cloud.attributes.iter().map(field).collect(),
    }
}

/// A column's bytes.
fn column(values: &Values) -> Vec<u8> {
    match values {
        Values::U8(column) => column.clone(),
        Values::I32(column) => column.iter().flat_map(|n| n.to_le_bytes()).collect(),
        Values::U32(column) => column.iter().flat_map(|n| n.to_le_bytes()).collect(),
        Values::F32(column) => column.iter().flat_map(|n| n.to_le_bytes()).collect(),
        other => panic!("no test has {other:?}"),
    }
}

fn coordinates(cloud: &Cloud, position_type: NumberType) -> Vec<u8> {
    let numbers = cloud.positions.as_flattened().iter();
    match position_type {
        NumberType::Float32 => numbers.flat_map(|n| (*n as f32).to_le_bytes()).collect(),
        _ => numbers.flat_map(|n| n.to_le_bytes()).collect(),
    }
}

/// A cloud as columns, in chunks of `size` points.
fn points(options: Options, cloud: &Cloud, position_type: NumberType, size: usize) -> Vec<UpsampleRequest> {
    let layout = layout(cloud, position_type);
    let width = if position_type == NumberType::Float32 { 12 } else { 24 };
    let positions = coordinates(cloud, position_type);
    let columns: Vec<(Vec<u8>, usize)> =
        cloud.attributes.iter().map(|a| (column(&a.values), a.values.kind().size())).collect();
    let mut messages = vec![message(In::Start(Start { options: Some(options), layout: Some(layout) }))];
    for first in (0..cloud.positions.len()).step_by(size) {
        let end = cloud.positions.len().min(first + size);
        messages.push(message(In::Points(PointChunk {
            positions: positions[first * width..end * width].to_vec().into(),
            fields: columns.iter().map(|(c, size)| c[first * size..end * size].to_vec().into()).collect(),
        })));
    }
    messages
}

/// All that an answer has, put together.
#[derive(Debug, Default)]
struct Answer {
    progress: Vec<Progress>,
    header: ResultHeader,
    file: Vec<u8>,
    positions: Vec<u8>,
    fields: Vec<Vec<u8>>,
    chunks: usize,
    /// What was told after the last chunk, of a result in tiles.
    ending: Option<Vec<String>>,
}

async fn ask(
    client: &mut UpsamplerClient<Channel>,
    request: impl Stream<Item = UpsampleRequest> + Send + 'static,
) -> Result<Answer, Status> {
    let mut stream = client.upsample(request).await?.into_inner();
    let mut answer = Answer::default();
    let mut headers = 0;
    while let Some(message) = stream.message().await? {
        assert!(answer.ending.is_none(), "the ending is the last");
        match message.message.expect("a message") {
            Out::Ending(ending) => answer.ending = Some(ending.warnings),
            Out::Progress(progress) => {
                assert_eq!(headers, 0, "progress comes before the result");
                answer.progress.push(progress);
            }
            Out::Header(header) => {
                headers += 1;
                answer.fields = vec![Vec::new(); header.layout.as_ref().map_or(0, |l| l.fields.len())];
                answer.header = header;
            }
            Out::FileChunk(bytes) => {
                assert!(bytes.len() <= 1 << 20 && answer.header.layout.is_none());
                answer.chunks += 1;
                answer.file.extend(bytes);
            }
            Out::Points(chunk) => {
                answer.chunks += 1;
                answer.positions.extend(chunk.positions);
                for (all, more) in answer.fields.iter_mut().zip(chunk.fields) {
                    all.extend(more);
                }
            }
        }
    }
    assert_eq!(headers, 1, "one header");
    Ok(answer)
}

async fn asked(server: &Server, messages: Vec<UpsampleRequest>) -> Result<Answer, Status> {
    ask(&mut client(server), stream::iter(messages)).await
}

/// A client that sends these messages and then keeps its side open.
fn open(messages: Vec<UpsampleRequest>) -> impl Stream<Item = UpsampleRequest> + Send + 'static {
    stream::iter(messages).chain(stream::pending())
}

fn plain(points: usize) -> Cloud {
    cloud(points).into()
}

fn with_attributes(points: usize) -> Cloud {
    let mut cloud = plain(points);
    let numbers = 0..points as u32;
    let attribute = |name: &str, values| Attribute { name: name.into(), values };
    cloud.attributes = vec![
        attribute("red", Values::U8(numbers.clone().map(|i| i as u8).collect())),
        attribute("label", Values::I32(numbers.clone().map(|i| 7 - i as i32).collect())),
        attribute("warmth", Values::F32(numbers.map(|i| i as f32 * 0.1).collect())),
    ];
    cloud
}

fn npy(cloud: &Cloud, scalar: Scalar) -> Vec<u8> {
    let format = Format::Npy { scalar, fields: true };
    densecloud_formats::encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &Origin::default())
        .unwrap()
}

fn read(bytes: &[u8]) -> Cloud {
    CloudReader::open(bytes, Limits::default()).unwrap().read().unwrap()
}
