// Receives FRAMES of what examples/publish_poses.rs sends with Fast DDS and compares every value; ends in 1 when one is
// missing, doubled, out of order or different: receive_poses FRAMES

#include "participant.hpp"

#include <chrono>
#include <cmath>
#include <thread>

using Clock = std::chrono::steady_clock;

static int wrong = 0;

static void expect(bool right, const char* topic, int index, const char* what) {
    if (!right && wrong++ < 10) std::fprintf(stderr, "%s %d: wrong %s\n", topic, index, what);
}

static void check(const ros::Header& header, const char* topic, int index) {
    const int64_t stamp = header.stamp.sec * 1'000'000'000LL + header.stamp.nanosec;
    expect(stamp == 1'700'000'000'000'000'000LL + index * 33'333'333LL, topic, index, "stamp");
    expect(header.frame_id == "camera_optical", topic, index, "frame_id");
}

static bool close(double a, double b) { return std::abs(a - b) <= 1e-15 * std::max(1.0, std::abs(b)); }

static void check(const ros::Pose& pose, int object, const char* topic, int index) {
    const auto& [p, q] = pose;
    const double right = object == 5 ? 0.0 : 1.0, half = 0.005 * index;
    expect(close(p.x, 0.001 * index + right) && close(p.y, -0.002 * index) && close(p.z, 1.0 + 0.003 * index), topic,
           index, "position");
    expect(q.x == 0 && q.y == 0 && close(q.z, std::sin(half)) && close(q.w, std::cos(half)), topic, index,
           "orientation");
}

static void check(const ros::PoseStamped& sample, int index) {
    check(sample.header, "object_pose", index);
    check(sample.pose, 5, "object_pose", index);
}

static void check(const ros::Detection3DArray& sample, int index) {
    const char* topic = "object_poses";
    check(sample.header, topic, index);
    const int objects[] = {5, 7};
    const char* names[] = {"mustard", "soup can"};
    const char* tokens[] = {"mustard", "soup_can"};
    const double scores[] = {0.9, 0.5};
    if (sample.detections.size() != 2) return expect(false, topic, index, "count");
    for (int i = 0; i < 2; ++i) {
        const auto& detection = sample.detections[i];
        check(detection.header, topic, index);
        expect(detection.id == tokens[i], topic, index, "id");
        if (detection.results.size() != 1) return expect(false, topic, index, "results");
        const auto& result = detection.results[0];
        expect(result.hypothesis.class_id == names[i], topic, index, "class_id");
        expect(result.hypothesis.score == scores[i], topic, index, "score");
        check(result.pose.pose, objects[i], topic, index);
        for (int e = 0; e < 36; ++e) expect(result.pose.covariance[e] == e + index, topic, index, "covariance");
    }
}

static void check(const ros::TFMessage& sample, int index) {
    const int objects[] = {5, 7};
    if (sample.transforms.size() != 2) return expect(false, "tf", index, "count");
    for (int i = 0; i < 2; ++i) {
        const auto& transform = sample.transforms[i];
        const char* tokens[] = {"mustard", "soup_can"};
        check(transform.header, "tf", index);
        expect(transform.child_frame_id == tokens[i], "tf", index, "child_frame_id");
        check(transform.transform, objects[i], "tf", index);
    }
}

template <class M> static void take(fast::DataReader* reader, int& count, Clock::time_point& last) {
    M sample;
    fast::SampleInfo info;
    while (reader->take_next_sample(&sample, &info) == ReturnCode_t::RETCODE_OK) {
        if (!info.valid_data) continue;
        check(sample, count++);
        last = Clock::now();
    }
}

int main(int, char** argv) {
    const int frames = std::atoi(argv[1]);
    Participant participant;
    auto* poses = participant.reader<ros::Detection3DArray>("rt/object_poses", "vision_msgs", "Detection3DArray", 8192);
    auto* tf = participant.reader<ros::TFMessage>("rt/tf", "tf2_msgs", "TFMessage", 4096);
    // The publisher waits for the reader of object_pose: it comes last.
    auto* pose = participant.reader<ros::PoseStamped>("rt/object_pose", "geometry_msgs", "PoseStamped", 512);
    int of_pose = 0, of_poses = 0, of_tf = 0;
    auto last = Clock::now();
    while (std::min({of_pose, of_poses, of_tf}) < frames && Clock::now() - last < std::chrono::seconds(60)) {
        take<ros::PoseStamped>(pose, of_pose, last);
        take<ros::Detection3DArray>(poses, of_poses, last);
        take<ros::TFMessage>(tf, of_tf, last);
        std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    std::printf("Fast DDS received, of %d: object_pose %d, object_poses %d, tf %d; wrong values: %d\n", frames, of_pose,
                of_poses, of_tf, wrong);
    return of_pose == frames && of_poses == frames && of_tf == frames && wrong == 0 ? 0 : 1;
}
