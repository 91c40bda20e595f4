//! PLY as BOP writes it: ascii or binary_little_endian, `comment TextureFile NAME`, texture coordinates by vertex
//! (`texture_u`, `texture_v`; also `s`, `t` or `u`, `v`) or by face (`list texcoord`), colours by vertex.

use crate::{ImagingError, Mesh, MeshParts, files::load_rgb};
use std::collections::{HashMap, HashSet};
use std::path::Path;

/// Reads a PLY mesh; `metres_per_unit` is 1e-3 for BOP files (millimetres).
///
/// # Errors
/// When the file or its texture cannot be read, the header is not understood, the body is too short, or the mesh
/// is not usable ([`Mesh::new`]).
pub fn load_ply(path: &Path, metres_per_unit: f64) -> Result<Mesh, ImagingError> {
    let bytes = std::fs::read(path).map_err(ImagingError::io(path))?;
    let header = Header::parse(&bytes, path)?;
    header.check(bytes.len() - header.body_at, path)?;
    let mut parts = Body::read(&header, &bytes, path)?.into_parts(metres_per_unit, path)?;
    if let Some(name) = &header.texture {
        let texture = path.with_file_name(name);
        if !texture.is_file() {
            let field = "comment TextureFile".to_owned();
            return Err(ImagingError::MissingTexture { path: path.to_owned(), field, texture });
        }
        parts.texture = Some(load_rgb(&texture)?);
    }
    Mesh::new(parts, path)
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }
}

impl Kind {
    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

enum Property {
    Scalar(String, Kind),
    List(String, Kind, Kind),
}

impl Property {
    fn name(&self) -> &str {
        match self {
            Self::Scalar(name, _) | Self::List(name, ..) => name,
        }
    }

    /// Bytes that it takes in a row at least: in text a digit and what parts it from the next.
    fn least_bytes(&self, ascii: bool) -> usize {
        match self {
            _ if ascii => 2,
            Self::Scalar(_, kind) | Self::List(_, kind, _) => kind.bytes(),
        }
    }
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

struct Header {
    ascii: bool,
    texture: Option<String>,
    elements: Vec<Element>,
    body_at: usize,
}

const REMEDY: &str = "export the mesh as ascii or binary_little_endian PLY 1.0";

impl Header {
    fn parse(bytes: &[u8], path: &Path) -> Result<Self, ImagingError> {
        let bad = |field: &str, what: &str| ImagingError::field(path, field, what, REMEDY);
        let mut header = Self { ascii: true, texture: None, elements: Vec::new(), body_at: 0 };
        let (mut at, mut format_seen) = (0, false);
        loop {
            let rest = bytes.get(at..).unwrap_or_default();
            let end =
                rest.iter().position(|&b| b == b'\n').ok_or_else(|| bad("end_header", "the header has no end"))?;
            let line = String::from_utf8_lossy(&rest[..end]).trim().to_owned();
            let first = at == 0;
            at += end + 1;
            if first {
                if line != "ply" {
                    return Err(bad("ply", "the file does not start with `ply`"));
                }
            } else if line == "end_header" {
                break;
            } else {
                format_seen |= line.starts_with("format");
                header.line(&line).map_err(|what| bad(&line, &what))?;
            }
        }
        if !format_seen {
            return Err(bad("format", "the header names no format"));
        }
        header.body_at = at;
        Ok(header)
    }

    /// What the header says must fit into the body: a count may claim anything, and costs time and memory for each row.
    fn check(&self, body_bytes: usize, path: &Path) -> Result<(), ImagingError> {
        let bad = |element: &Element, what: String| {
            ImagingError::field(path, format!("element {}", element.name), what, "the file is damaged: copy it again")
        };
        let mut elements = HashSet::new();
        for element in &self.elements {
            let mut names = HashSet::new();
            if let Some(twice) = element.properties.iter().find(|property| !names.insert(property.name())) {
                return Err(bad(element, format!("property {} is there twice", twice.name())));
            }
            if !elements.insert(&element.name) {
                return Err(bad(element, "the element is there twice".to_owned()));
            }
            let row: usize = element.properties.iter().map(|property| property.least_bytes(self.ascii)).sum();
            // The last row of a text needs no end of its own.
            let least = element.count.checked_mul(row.max(1)).map(|bytes| bytes.saturating_sub(1));
            if least.is_none_or(|bytes| bytes > body_bytes) {
                let what =
                    format!("{} entries do not fit into the {body_bytes} bytes behind the header", element.count);
                return Err(bad(element, what));
            }
        }
        Ok(())
    }

    fn line(&mut self, line: &str) -> Result<(), String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["format", "ascii", _] => self.ascii = true,
            ["format", "binary_little_endian", _] => self.ascii = false,
            ["format", other, ..] => return Err(format!("format {other} is not supported")),
            ["comment", "TextureFile", ..] => {
                self.texture = line.split_once("TextureFile").map(|(_, name)| name.trim().to_owned());
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| format!("the count {count} is no number"))?;
                self.elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            ["property", rest @ ..] => {
                let property = parse_property(rest).ok_or("an unknown property type")?;
                self.elements.last_mut().ok_or("a property before any element")?.properties.push(property);
            }
            [] | ["comment" | "obj_info", ..] => {}
            _ => return Err("an unknown header line".to_owned()),
        }
        Ok(())
    }
}

fn parse_property(words: &[&str]) -> Option<Property> {
    match words {
        ["list", count, item, name] => {
            Some(Property::List((*name).to_owned(), Kind::parse(count)?, Kind::parse(item)?))
        }
        [kind, name] => Some(Property::Scalar((*name).to_owned(), Kind::parse(kind)?)),
        _ => None,
    }
}

/// Hands out the numbers of the body one after another.
enum Numbers<'a> {
    Ascii(std::str::SplitAsciiWhitespace<'a>),
    Binary(&'a [u8]),
}

impl Numbers<'_> {
    fn next(&mut self, kind: Kind) -> Option<f64> {
        match self {
            Self::Ascii(words) => words.next()?.parse().ok(),
            Self::Binary(bytes) => Some(match kind {
                Kind::I8 => f64::from(i8::from_le_bytes(take(bytes)?)),
                Kind::U8 => f64::from(u8::from_le_bytes(take(bytes)?)),
                Kind::I16 => f64::from(i16::from_le_bytes(take(bytes)?)),
                Kind::U16 => f64::from(u16::from_le_bytes(take(bytes)?)),
                Kind::I32 => f64::from(i32::from_le_bytes(take(bytes)?)),
                Kind::U32 => f64::from(u32::from_le_bytes(take(bytes)?)),
                Kind::F32 => f64::from(f32::from_le_bytes(take(bytes)?)),
                Kind::F64 => f64::from_le_bytes(take(bytes)?),
            }),
        }
    }
}

fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (head, tail) = bytes.split_first_chunk::<N>()?;
    *bytes = tail;
    Some(*head)
}

/// Columns of the vertex element by name, and the faces.
#[derive(Default)]
struct Body {
    columns: HashMap<String, Vec<f64>>,
    float_colours: bool,
    vertices: usize,
    faces: Vec<Vec<f64>>,
    face_texcoords: Vec<Vec<f64>>,
}

impl Body {
    fn read(header: &Header, bytes: &[u8], path: &Path) -> Result<Self, ImagingError> {
        let raw = &bytes[header.body_at..];
        let text;
        let mut numbers = match header.ascii {
            true => {
                text = String::from_utf8_lossy(raw);
                Numbers::Ascii(text.split_ascii_whitespace())
            }
            false => Numbers::Binary(raw),
        };
        let mut body = Self::default();
        for element in &header.elements {
            for row in 0..element.count {
                body.row(element, &mut numbers).ok_or_else(|| {
                    let what = format!("the file ends, or holds no number, at entry {row} of {}", element.count);
                    ImagingError::field(
                        path,
                        format!("element {}", element.name),
                        what,
                        "the file is damaged: copy it again",
                    )
                })?;
            }
        }
        Ok(body)
    }

    fn row(&mut self, element: &Element, numbers: &mut Numbers<'_>) -> Option<()> {
        let (is_vertex, is_face) = (element.name == "vertex", element.name == "face");
        self.vertices += usize::from(is_vertex);
        for property in &element.properties {
            match property {
                Property::Scalar(name, kind) => {
                    let value = numbers.next(*kind)?;
                    if is_vertex {
                        self.float_colours |= name == "red" && matches!(kind, Kind::F32 | Kind::F64);
                        match self.columns.get_mut(name) {
                            Some(column) => column.push(value),
                            None => drop(self.columns.insert(name.clone(), vec![value])),
                        }
                    }
                }
                Property::List(name, count, kind) => {
                    let count = numbers.next(*count)?;
                    // No allocation by the count: a damaged file may claim anything.
                    let list = (0..count as usize).map(|_| numbers.next(*kind)).collect::<Option<Vec<f64>>>()?;
                    match name.as_str() {
                        "vertex_indices" | "vertex_index" if is_face => self.faces.push(list),
                        "texcoord" if is_face => self.face_texcoords.push(list),
                        _ => {}
                    }
                }
            }
        }
        Some(())
    }

    /// The named columns side by side, when all are there.
    fn columns<const N: usize>(&self, names: [&str; N]) -> Option<Vec<[f64; N]>> {
        let columns = names.map(|name| self.columns.get(name));
        if columns.iter().any(Option::is_none) {
            return None;
        }
        Some((0..self.vertices).map(|i| columns.map(|c| c.map_or(0.0, |c| c[i]))).collect())
    }

    fn into_parts(self, metres_per_unit: f64, path: &Path) -> Result<MeshParts, ImagingError> {
        let Some(positions) = self.columns(["x", "y", "z"]) else {
            let what = "the vertices have no x, y, z";
            return Err(ImagingError::field(path, "element vertex", what, "export the mesh with positions"));
        };
        let colour_unit = if self.float_colours { 255.0 } else { 1.0 };
        let byte = |v: f64| (v * colour_unit).round().clamp(0.0, 255.0) as u8;
        let texcoords = self
            .columns(["texture_u", "texture_v"])
            .or_else(|| self.columns(["s", "t"]))
            .or_else(|| self.columns(["u", "v"]));
        let mut parts = MeshParts {
            vertices_m: positions.iter().map(|p| p.map(|c| (c * metres_per_unit) as f32)).collect(),
            normals: to_f32(self.columns(["nx", "ny", "nz"]).unwrap_or_default()),
            texcoords: to_f32(texcoords.unwrap_or_default()),
            colours: self.columns(["red", "green", "blue"]).unwrap_or_default().iter().map(|c| c.map(byte)).collect(),
            triangles: Vec::new(),
            texture: None,
        };
        let by_face = parts.texcoords.is_empty() && self.face_texcoords.len() == self.faces.len();
        let mut split = by_face.then(CornerSplit::default);
        for (face, corners) in self.faces.iter().enumerate() {
            let corners = indices(face, corners, self.vertices, path)?;
            let corners = match &mut split {
                Some(split) => split.face(&corners, &self.face_texcoords[face]),
                None => corners,
            };
            let fan = (2..corners.len()).map(|i| [corners[0], corners[i - 1], corners[i]]);
            parts.triangles.extend(fan);
        }
        Ok(match split {
            Some(split) if !self.faces.is_empty() => split.apply(parts),
            _ => parts,
        })
    }
}

fn to_f32<const N: usize>(rows: Vec<[f64; N]>) -> Vec<[f32; N]> {
    rows.into_iter().map(|row| row.map(|c| c as f32)).collect()
}

fn indices(face: usize, corners: &[f64], vertices: usize, path: &Path) -> Result<Vec<u32>, ImagingError> {
    let index = |&c: &f64| match c >= 0.0 && c < vertices as f64 && c.fract() == 0.0 {
        true => Ok(c as u32),
        false => Err(ImagingError::IndexRange { path: path.to_owned(), face, index: c as i64, vertices }),
    };
    corners.iter().map(index).collect()
}

/// Texture coordinates by face become coordinates by vertex: a vertex is doubled where its coordinates differ.
#[derive(Default)]
struct CornerSplit {
    known: HashMap<(u32, [u32; 2]), u32>,
    vertex_of: Vec<u32>,
    texcoords: Vec<[f32; 2]>,
}

impl CornerSplit {
    fn face(&mut self, corners: &[u32], texcoords: &[f64]) -> Vec<u32> {
        let uv = |k: usize| [0, 1].map(|j| texcoords.get(2 * k + j).map_or(f32::NAN, |&c| c as f32));
        let new = corners.iter().enumerate().map(|(k, &vertex)| {
            let uv = uv(k);
            *self.known.entry((vertex, uv.map(f32::to_bits))).or_insert_with(|| {
                self.vertex_of.push(vertex);
                self.texcoords.push(uv);
                self.vertex_of.len() as u32 - 1
            })
        });
        new.collect()
    }

    fn apply(self, parts: MeshParts) -> MeshParts {
        fn pick<T: Copy>(from: &[T], vertex_of: &[u32]) -> Vec<T> {
            if from.is_empty() { Vec::new() } else { vertex_of.iter().map(|&v| from[v as usize]).collect() }
        }
        MeshParts {
            vertices_m: pick(&parts.vertices_m, &self.vertex_of),
            normals: pick(&parts.normals, &self.vertex_of),
            colours: pick(&parts.colours, &self.vertex_of),
            texcoords: self.texcoords,
            ..parts
        }
    }
}
