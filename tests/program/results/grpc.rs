//! The gRPC interface as a door, with the client that is generated from its contract.

use densecloud_server::proto::{
    Field, Layout, NumberType, Options, PointChunk, Position, Start, UpsampleRequest, UpsampleResponse,
    options::{Goal, Result as Wanted},
    upsample_request::Message as In,
    upsample_response::Message as Out,
    upsampler_client::UpsamplerClient,
};
use futures::stream;
use tonic::transport::Endpoint;

use super::Case;
use super::clouds::{Kind, Points};
use super::doors::{Place, cloud};

/// Bytes of a file, and points, in a message: several messages for each case.
const PIECE: usize = 5000;
const ROWS: usize = 150;

/// The file's bytes; of numbers the layout, the positions, then each field's column.
pub(super) fn ask(place: &Place, case: &Case) -> Vec<u8> {
    let request = if case.input.contains('.') { file(place, case) } else { columns(case) };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let answers = runtime.block_on(async {
        let channel = Endpoint::from_shared(place.serving.url("")).expect("an address").connect_lazy();
        let answer = UpsamplerClient::new(channel).upsample(stream::iter(request)).await;
        let mut stream = answer.unwrap_or_else(|e| panic!("{}: {e}", case.name())).into_inner();
        let mut answers = Vec::new();
        while let Some(answer) = stream.message().await.unwrap_or_else(|e| panic!("{}: {e}", case.name())) {
            answers.push(answer);
        }
        answers
    });
    together(answers)
}

fn together(answers: Vec<UpsampleResponse>) -> Vec<u8> {
    let [mut bytes, mut positions] = [Vec::new(), Vec::new()];
    let mut columns: Vec<Vec<u8>> = Vec::new();
    for answer in answers {
        match answer.message.expect("a message") {
            // How many of them there are is a matter of time, and none of these clouds is in tiles.
            Out::Progress(_) | Out::Ending(_) => {}
            Out::Header(header) => {
                let layout = header.layout.unwrap_or_default();
                columns = vec![Vec::new(); layout.fields.len()];
                let fields = layout.fields.iter().map(|f| format!("{} {} ", f.name, f.r#type));
                bytes.extend(fields.collect::<String>().into_bytes());
            }
            Out::FileChunk(piece) => bytes.extend(piece),
            Out::Points(chunk) => {
                positions.extend(chunk.positions);
                columns.iter_mut().zip(chunk.fields).for_each(|(column, more)| column.extend(more));
            }
        }
    }
    [bytes, positions, columns.concat()].concat()
}

fn file(place: &Place, case: &Case) -> Vec<UpsampleRequest> {
    let bytes = place.read(case.input);
    let chunks = bytes.chunks(PIECE).map(|piece| In::FileChunk(piece.to_vec().into()));
    messages(Start { options: Some(options(case)), layout: None }, chunks)
}

fn columns(case: &Case) -> Vec<UpsampleRequest> {
    let points = cloud(case);
    let scalar = if case.input == "ground" { Kind::F64 } else { Kind::F32 };
    let fields = points.columns.iter().map(|c| Field { name: c.name.into(), r#type: number(c.kind).into() });
    let layout = Layout {
        points: points.positions.len() as u64,
        position_type: number(scalar).into(),
        fields: fields.collect(),
    };
    let chunks = (0..points.positions.len()).step_by(ROWS).map(|first| chunk(&points, scalar, first));
    messages(Start { options: Some(options(case)), layout: Some(layout) }, chunks)
}

fn messages(start: Start, chunks: impl Iterator<Item = In>) -> Vec<UpsampleRequest> {
    let message = |message| UpsampleRequest { message: Some(message) };
    std::iter::once(In::Start(start)).chain(chunks).map(message).collect()
}

fn chunk(points: &Points, scalar: Kind, first: usize) -> In {
    let rows = first..points.positions.len().min(first + ROWS);
    let column =
        |kind: Kind, values: &[f64]| values.iter().flat_map(|v| kind.little(*v)).collect::<Vec<u8>>();
    In::Points(PointChunk {
        positions: column(scalar, points.positions[rows.clone()].as_flattened()).into(),
        fields: points.columns.iter().map(|c| column(c.kind, &c.values[rows.clone()]).into()).collect(),
    })
}

fn number(kind: Kind) -> NumberType {
    match kind {
        Kind::U8 => NumberType::Uint8,
        Kind::U16 => NumberType::Uint16,
        Kind::U32 => NumberType::Uint32,
        Kind::I32 => NumberType::Int32,
        Kind::F32 => NumberType::Float32,
        Kind::F64 => NumberType::Float64,
    }
}

fn options(case: &Case) -> Options {
    let mut options = Options::default();
    for (name, value) in case.options() {
        let number = || value.parse().expect("a number");
        match name {
            "ratio" => options.goal = Some(Goal::Ratio(number())),
            "points" => options.goal = Some(Goal::Points(number() as u64)),
            "spacing" => options.goal = Some(Goal::Spacing(number())),
            "density" => options.goal = Some(Goal::Density(number())),
            "seed" => options.seed = number() as u64,
            "attributes" => options.attributes = value.into(),
            "keep_input" => options.keep_input = true,
            "source_fields" => options.source_fields = true,
            "normals" => options.estimate_normals = true,
            "sensor" => options.sensor = Some(position(value)),
            _ => panic!("{}: no option {name:?}", case.name()),
        }
    }
    options.result = match case.output {
        "-" => None,
        "points" => Some(Wanted::AsPoints(true)),
        media_type => Some(Wanted::MediaType(media_type.into())),
    };
    options
}

fn position(text: &str) -> Position {
    let numbers: Vec<f64> = text.split(',').map(|n| n.parse().expect("a number")).collect();
    Position { x: numbers[0], y: numbers[1], z: numbers[2] }
}
