// The ROS 2 messages that the interop tests exchange, as Fast DDS types, written down from the .msg files.
// Fast DDS 2.9 and Fast CDR 1 (Debian 12: libfastrtps-dev, libfastcdr-dev).
#pragma once

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/topic/TopicDataType.hpp>

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <type_traits>
#include <vector>

namespace ros {

struct Time { int32_t sec = 0; uint32_t nanosec = 0; };
struct Header { Time stamp; std::string frame_id; };
struct Point { double x = 0, y = 0, z = 0; };
struct Quaternion { double x = 0, y = 0, z = 0, w = 1; };
struct Pose { Point position; Quaternion orientation; };
struct PoseStamped { Header header; Pose pose; };
struct PoseWithCovariance { Pose pose; std::array<double, 36> covariance{}; };
struct ObjectHypothesis { std::string class_id; double score = 0; };
struct ObjectHypothesisWithPose { ObjectHypothesis hypothesis; PoseWithCovariance pose; };
struct BoundingBox3D { Pose center; Point size; };
struct Detection3D { Header header; std::vector<ObjectHypothesisWithPose> results; BoundingBox3D bbox; std::string id; };
struct Detection3DArray { Header header; std::vector<Detection3D> detections; };
struct TransformStamped { Header header; std::string child_frame_id; Pose transform; };
struct TFMessage { std::vector<TransformStamped> transforms; };
struct Image {
    Header header;
    uint32_t height = 0, width = 0;
    std::string encoding;
    uint8_t is_bigendian = 0;
    uint32_t step = 0;
    std::vector<uint8_t> data;
};
struct CompressedImage { Header header; std::string format; std::vector<uint8_t> data; };
struct RegionOfInterest { uint32_t x_offset = 0, y_offset = 0, height = 0, width = 0; bool do_rectify = false; };
struct CameraInfo {
    Header header;
    uint32_t height = 0, width = 0;
    std::string distortion_model;
    std::vector<double> d;
    std::array<double, 9> k{}, r{};
    std::array<double, 12> p{};
    uint32_t binning_x = 0, binning_y = 0;
    RegionOfInterest roi;
};

// The fields of each type in the order of its .msg file, for reading and for writing.
template <class S> void fields(S& s, Time& m) { s(m.sec, m.nanosec); }
template <class S> void fields(S& s, Header& m) { s(m.stamp, m.frame_id); }
template <class S> void fields(S& s, Point& m) { s(m.x, m.y, m.z); }
template <class S> void fields(S& s, Quaternion& m) { s(m.x, m.y, m.z, m.w); }
template <class S> void fields(S& s, Pose& m) { s(m.position, m.orientation); }
template <class S> void fields(S& s, PoseStamped& m) { s(m.header, m.pose); }
template <class S> void fields(S& s, PoseWithCovariance& m) { s(m.pose, m.covariance); }
template <class S> void fields(S& s, ObjectHypothesis& m) { s(m.class_id, m.score); }
template <class S> void fields(S& s, ObjectHypothesisWithPose& m) { s(m.hypothesis, m.pose); }
template <class S> void fields(S& s, BoundingBox3D& m) { s(m.center, m.size); }
template <class S> void fields(S& s, Detection3D& m) { s(m.header, m.results, m.bbox, m.id); }
template <class S> void fields(S& s, Detection3DArray& m) { s(m.header, m.detections); }
template <class S> void fields(S& s, TransformStamped& m) { s(m.header, m.child_frame_id, m.transform); }
template <class S> void fields(S& s, TFMessage& m) { s(m.transforms); }
template <class S> void fields(S& s, Image& m) {
    s(m.header, m.height, m.width, m.encoding, m.is_bigendian, m.step, m.data);
}
template <class S> void fields(S& s, CompressedImage& m) { s(m.header, m.format, m.data); }
template <class S> void fields(S& s, RegionOfInterest& m) {
    s(m.x_offset, m.y_offset, m.height, m.width, m.do_rectify);
}
template <class S> void fields(S& s, CameraInfo& m) {
    s(m.header, m.height, m.width, m.distortion_model, m.d, m.k, m.r, m.p, m.binning_x, m.binning_y, m.roi);
}

template <class T> struct plain : std::bool_constant<std::is_arithmetic_v<T> || std::is_same_v<T, std::string>> {};
template <class T, size_t N> struct plain<std::array<T, N>> : std::true_type {};
template <class T> struct plain<std::vector<T>> : std::is_arithmetic<T> {};
template <class T> struct is_vector : std::false_type {};
template <class T> struct is_vector<std::vector<T>> : std::true_type {};

struct Writer {
    eprosima::fastcdr::Cdr& cdr;
    template <class... T> void operator()(T&... values) { (one(values), ...); }
    template <class T> void one(T& value) {
        if constexpr (plain<T>::value) {
            cdr << value;
        } else if constexpr (is_vector<T>::value) {
            cdr << static_cast<uint32_t>(value.size());
            for (auto& element : value) one(element);
        } else {
            fields(*this, value);
        }
    }
};

struct Reader {
    eprosima::fastcdr::Cdr& cdr;
    template <class... T> void operator()(T&... values) { (one(values), ...); }
    template <class T> void one(T& value) {
        if constexpr (plain<T>::value) {
            cdr >> value;
        } else if constexpr (is_vector<T>::value) {
            uint32_t count = 0;
            cdr >> count;
            value.clear();
            for (uint32_t i = 0; i < count; ++i) one(value.emplace_back());
        } else {
            fields(*this, value);
        }
    }
};

// A message as Fast DDS wants its types. `largest` bounds the serialised size.
template <class M> class Type : public eprosima::fastdds::dds::TopicDataType {
public:
    Type(const std::string& package, const std::string& name, uint32_t largest) {
        setName((package + "::msg::dds_::" + name + "_").c_str());
        m_typeSize = largest;
        m_isGetKeyDefined = false;
    }

    bool serialize(void* data, eprosima::fastrtps::rtps::SerializedPayload_t* payload) override {
        eprosima::fastcdr::FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->max_size);
        eprosima::fastcdr::Cdr cdr(buffer, eprosima::fastcdr::Cdr::DEFAULT_ENDIAN, eprosima::fastcdr::Cdr::DDS_CDR);
        try {
            cdr.serialize_encapsulation();
            Writer{cdr}(*static_cast<M*>(data));
        } catch (const eprosima::fastcdr::exception::Exception&) {
            return false;
        }
        payload->encapsulation = CDR_LE;
        payload->length = static_cast<uint32_t>(cdr.getSerializedDataLength());
        return true;
    }

    bool deserialize(eprosima::fastrtps::rtps::SerializedPayload_t* payload, void* data) override {
        eprosima::fastcdr::FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->length);
        eprosima::fastcdr::Cdr cdr(buffer, eprosima::fastcdr::Cdr::DEFAULT_ENDIAN, eprosima::fastcdr::Cdr::DDS_CDR);
        try {
            cdr.read_encapsulation();
            Reader{cdr}(*static_cast<M*>(data));
        } catch (const eprosima::fastcdr::exception::Exception&) {
            return false;
        }
        return true;
    }

    std::function<uint32_t()> getSerializedSizeProvider(void*) override {
        return [size = m_typeSize] { return size; };
    }
    void* createData() override { return new M(); }
    void deleteData(void* data) override { delete static_cast<M*>(data); }
    bool getKey(void*, eprosima::fastrtps::rtps::InstanceHandle_t*, bool) override { return false; }
};

}  // namespace ros
