// Plays a camera and a detector with Fast DDS for examples/receive_images.rs: 640 x 480.
//     send_images raw FRAMES HZ
//     send_images compressed FRAMES HZ FOLDER     (FOLDER/0.jpg, 1.jpg, ... are sent)

#include "participant.hpp"

#include <chrono>
#include <fstream>
#include <iterator>
#include <thread>

static const uint32_t WIDTH = 640, HEIGHT = 480;

static ros::Header now() {
    const auto since = std::chrono::system_clock::now().time_since_epoch();
    const int64_t ns = std::chrono::duration_cast<std::chrono::nanoseconds>(since).count();
    return {{static_cast<int32_t>(ns / 1'000'000'000), static_cast<uint32_t>(ns % 1'000'000'000)}, "camera_optical"};
}

static ros::Image picture(int index) {
    ros::Image image;
    image.height = HEIGHT;
    image.width = WIDTH;
    image.encoding = "rgb8";
    image.step = WIDTH * 3;
    image.data.resize(WIDTH * HEIGHT * 3);
    for (size_t i = 0; i < image.data.size(); i += 3) {
        image.data[i] = static_cast<uint8_t>(index);
        image.data[i + 1] = 100;
        image.data[i + 2] = 200;
    }
    return image;
}

static ros::CompressedImage file(const std::string& folder, int index) {
    ros::CompressedImage image;
    image.format = "rgb8; jpeg compressed rgb8";
    std::ifstream stream(folder + "/" + std::to_string(index) + ".jpg", std::ios::binary);
    image.data.assign(std::istreambuf_iterator<char>(stream), {});
    return image;
}

static ros::CameraInfo camera_info(const ros::Header& header) {
    ros::CameraInfo info;
    info.header = header;
    info.height = HEIGHT;
    info.width = WIDTH;
    info.distortion_model = "plumb_bob";
    info.d = {0, 0, 0, 0, 0};
    info.k = {600, 0, 319.5, 0, 601, 239.5, 0, 0, 1};
    info.r = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    info.p = {600, 0, 319.5, 0, 0, 601, 239.5, 0, 0, 0, 1, 0};
    return info;
}

static ros::Detection3DArray detections(const ros::Header& header) {
    ros::Pose pose;
    pose.position = {0.1, 0.2, 0.3};
    ros::ObjectHypothesisWithPose result;
    result.hypothesis = {"5", 0.8};
    result.pose.pose = pose;
    return {header, {{header, {result}, {pose, {}}, "0"}}};
}

static bool wait(std::initializer_list<fast::DataWriter*> writers) {
    for (auto* writer : writers) {
        fast::PublicationMatchedStatus status;
        for (int tries = 0; writer->get_publication_matched_status(status), status.current_count == 0; ++tries) {
            if (tries == 3000) return false;
            std::this_thread::sleep_for(std::chrono::milliseconds(20));
        }
    }
    std::this_thread::sleep_for(std::chrono::seconds(1));
    return true;
}

int main(int count, char** argv) {
    const bool raw = std::string(argv[1]) == "raw";
    const int frames = std::atoi(argv[2]);
    const auto period = std::chrono::duration<double>(1.0 / std::atof(argv[3]));
    const std::string folder = count > 4 ? argv[4] : "";
    Participant participant;
    const uint32_t largest = WIDTH * HEIGHT * 3 + 1024;
    auto* images = raw ? participant.writer<ros::Image>("rt/camera/image", "sensor_msgs", "Image", largest)
                       : participant.writer<ros::CompressedImage>("rt/camera/image", "sensor_msgs", "CompressedImage", 50'000);
    auto* infos = participant.writer<ros::CameraInfo>("rt/camera/camera_info", "sensor_msgs", "CameraInfo", 1024);
    auto* arrays =
        participant.writer<ros::Detection3DArray>("rt/camera/detections", "vision_msgs", "Detection3DArray", 4096);
    if (!wait({images, infos, arrays})) {
        std::fprintf(stderr, "the camera node was not found within 60 s\n");
        return 1;
    }
    for (int index = 0; index < frames; ++index) {
        const auto started = std::chrono::steady_clock::now();
        ros::Image plain = raw ? picture(index) : ros::Image();
        ros::CompressedImage compressed = raw ? ros::CompressedImage() : file(folder, index);
        const ros::Header header = plain.header = compressed.header = now();
        // The small messages first: the image's arrival then completes the frame.
        auto info = camera_info(header);
        auto array = detections(header);
        const bool sent = infos->write(&info) && arrays->write(&array) &&
                          (raw ? images->write(&plain) : images->write(&compressed));
        if (!sent) {
            std::fprintf(stderr, "frame %d could not be written\n", index);
            return 1;
        }
        std::this_thread::sleep_until(started + std::chrono::duration_cast<std::chrono::nanoseconds>(period));
    }
    std::this_thread::sleep_for(std::chrono::seconds(2));
    return 0;
}
