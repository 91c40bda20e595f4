use pseudoflow_geometry::{IntrinsicsError, PoseError};
use std::path::{Path, PathBuf};

/// Why a file could not become an image, a mesh, an object set or a scene. Each message names the file, the field
/// and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ImagingError {
    /// The file system refused.
    #[error("{path}: {source}: check that the file exists and may be read or written")]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// An image could not be decoded or encoded.
    #[error("{path}: not a readable image: {source}; expected an intact JPEG or PNG")]
    Image {
        /// The file, or what the bytes were.
        path: PathBuf,
        /// The cause.
        source: image::ImageError,
    },
    /// JSON of a wrong form.
    #[error("{path}: {source}; expected the BOP format (see bop_toolkit, docs/bop_datasets_format.md)")]
    Json {
        /// The file.
        path: PathBuf,
        /// The cause, with line and column.
        source: serde_json::Error,
    },
    /// A field holds something else than it should.
    #[error("{path}: field `{field}`: {what}; {remedy}")]
    Field {
        /// The file.
        path: PathBuf,
        /// The field of the file.
        field: String,
        /// What was found.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A mesh without triangles cannot be rendered.
    #[error("{path}: field `element face`: the mesh has no faces (a point cloud?); export it with triangles")]
    NoFaces {
        /// The mesh.
        path: PathBuf,
    },
    /// A folder without objects.
    #[error(
        "{path}: no objects: expected models_info.json or a mesh named obj_000001.ply or obj_000001.obj; meshes there: {meshes:?}"
    )]
    NoObjects {
        /// The folder.
        path: PathBuf,
        /// Meshes of other names.
        meshes: Vec<String>,
    },
    /// `models_info.json` lists an object without a mesh.
    #[error("{path}: models_info.json lists object {id}, but there is neither obj_{id:06}.ply nor obj_{id:06}.obj")]
    NoMesh {
        /// The folder.
        path: PathBuf,
        /// The object.
        id: u32,
    },
    /// The object is too small or too large to be meant.
    #[error(
        "{path}: field `{field}`: the object's diameter is {diameter_m} m, outside 0.005 m .. 5 m (wrong unit?); models_info.json is in millimetres, and so is a mesh unless models_info.json states its unit: {{\"1\": {{\"mesh_unit\": \"m\"}}}}"
    )]
    Diameter {
        /// The mesh or models_info.json.
        path: PathBuf,
        /// Where the diameter comes from.
        field: String,
        /// The diameter that follows from the assumed unit.
        diameter_m: f64,
    },
    /// The mesh names a texture that is not there.
    #[error("{path}: field `{field}`: the texture {texture} does not exist; put it beside the mesh or remove the line")]
    MissingTexture {
        /// The mesh.
        path: PathBuf,
        /// The line that names it.
        field: String,
        /// The texture's path.
        texture: PathBuf,
    },
    /// A NaN or an infinity.
    #[error("{path}: field `{field}` of vertex {index} is not finite; repair the mesh")]
    NotFinite {
        /// The mesh.
        path: PathBuf,
        /// The attribute.
        field: &'static str,
        /// The vertex, from zero.
        index: usize,
    },
    /// A triangle names a vertex that does not exist.
    #[error(
        "{path}: field `vertex_indices` of face {face}: index {index}, but there are {vertices} vertices; repair the mesh"
    )]
    IndexRange {
        /// The mesh.
        path: PathBuf,
        /// The face, from zero.
        face: usize,
        /// The index found.
        index: i64,
        /// The number of vertices.
        vertices: usize,
    },
    /// An object id that the set does not hold.
    #[error("{path}: unknown object id {id}; the set holds {known:?}")]
    UnknownObject {
        /// The object set's folder, or the file that names the id.
        path: PathBuf,
        /// The id asked for.
        id: u32,
        /// The ids there are.
        known: Vec<u32>,
    },
    /// An image that the scene does not hold.
    #[error("{path}: no image for id {image_id} in rgb/ or gray/ (.png, .jpg); check that the scene is complete")]
    MissingImage {
        /// The scene's folder.
        path: PathBuf,
        /// The image id.
        image_id: u32,
    },
    /// A pose of a file is none.
    #[error("{path}: field `{field}`: {source}")]
    Pose {
        /// The file.
        path: PathBuf,
        /// The entry.
        field: String,
        /// The cause.
        source: PoseError,
    },
    /// A camera matrix of a file is none.
    #[error("{path}: field `{field}`: {source}")]
    Intrinsics {
        /// The file.
        path: PathBuf,
        /// The entry.
        field: String,
        /// The cause.
        source: Box<IntrinsicsError>,
    },
}

impl ImagingError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }

    pub(crate) fn field(path: &Path, field: impl Into<String>, what: impl Into<String>, remedy: &'static str) -> Self {
        Self::Field { path: path.to_owned(), field: field.into(), what: what.into(), remedy }
    }
}
