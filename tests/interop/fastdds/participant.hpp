// A Fast DDS participant on 127.0.0.1 alone, without multicast, and topics as ROS 2 names them.
#pragma once

#include "ros_types.hpp"

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include <cstdio>
#include <cstdlib>
#include <memory>

namespace fast = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;

struct Participant {
    fast::DomainParticipant* participant;
    fast::Publisher* publisher;
    fast::Subscriber* subscriber;

    Participant() {
        auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
        udp->interfaceWhiteList = {"127.0.0.1"};
        udp->sendBufferSize = udp->receiveBufferSize = 4 << 20;
        // As many participants as RustDDS announces itself to on this host.
        udp->maxInitialPeersRange = 12;
        fast::DomainParticipantQos qos;
        qos.transport().use_builtin_transports = false;
        qos.transport().user_transports.push_back(udp);
        rtps::Locator_t localhost;
        rtps::IPLocator::setIPv4(localhost, 127, 0, 0, 1);
        auto& builtin = qos.wire_protocol().builtin;
        builtin.initialPeersList.push_back(localhost);
        builtin.metatrafficUnicastLocatorList.push_back(localhost);
        builtin.discovery_config.initial_announcements.period = {0, 200'000'000};
        const char* domain = std::getenv("ROS_DOMAIN_ID");
        auto* factory = fast::DomainParticipantFactory::get_instance();
        participant = factory->create_participant(domain ? std::atoi(domain) : 0, qos);
        if (!participant) {
            std::fprintf(stderr, "Fast DDS: no participant\n");
            std::exit(2);
        }
        publisher = participant->create_publisher(fast::PUBLISHER_QOS_DEFAULT);
        subscriber = participant->create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT);
    }

    template <class M> fast::Topic* topic(const char* name, const char* package, const char* type, uint32_t largest) {
        fast::TypeSupport support(new ros::Type<M>(package, type, largest));
        support.register_type(participant);
        return participant->create_topic(name, support.get_type_name(), fast::TOPIC_QOS_DEFAULT);
    }

    template <class M>
    fast::DataReader* reader(const char* name, const char* package, const char* type, uint32_t largest) {
        fast::DataReaderQos qos;
        qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
        qos.history().kind = fast::KEEP_ALL_HISTORY_QOS;
        qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
        return subscriber->create_datareader(topic<M>(name, package, type, largest), qos);
    }

    template <class M>
    fast::DataWriter* writer(const char* name, const char* package, const char* type, uint32_t largest) {
        fast::DataWriterQos qos;
        qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
        qos.history().kind = fast::KEEP_LAST_HISTORY_QOS;
        qos.history().depth = 10;
        qos.publish_mode().kind = fast::SYNCHRONOUS_PUBLISH_MODE;
        if (largest > 60'000) qos.publish_mode().kind = fast::ASYNCHRONOUS_PUBLISH_MODE;
        qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
        return publisher->create_datawriter(topic<M>(name, package, type, largest), qos);
    }

    ~Participant() {
        participant->delete_contained_entities();
        fast::DomainParticipantFactory::get_instance()->delete_participant(participant);
    }
};
