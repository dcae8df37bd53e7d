// A plain Fast DDS program that behaves as a ROS 2 node on rmw_fastrtps_cpp: it shares no code with armcell.
//
// Reads commands from standard input, one a line, and answers each with one line. Samples are CDR in
// hexadecimal digits, with their four bytes of encapsulation; JointState is encoded by Fast CDR itself.
//
//     peer DOMAIN lo|all      lo: as ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, all: multicast, every interface

#include <chrono>
#include <cstring>
#include <iostream>
#include <map>
#include <mutex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <fastcdr/Cdr.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::SerializedPayload_t;
using Bytes = std::vector<uint8_t>;

// Samples as bytes, under any type's name: what rmw_fastrtps does with its serialized messages.
class RawType : public TopicDataType
{
public:
    explicit RawType(const std::string& name)
    {
        setName(name.c_str());
        m_typeSize = 1 << 16;
        m_isGetKeyDefined = false;
    }

    bool serialize(void* data, SerializedPayload_t* payload) override
    {
        const Bytes& bytes = *static_cast<Bytes*>(data);
        payload->length = static_cast<uint32_t>(bytes.size());
        payload->encapsulation = CDR_LE;
        std::memcpy(payload->data, bytes.data(), bytes.size());
        return true;
    }

    bool deserialize(SerializedPayload_t* payload, void* data) override
    {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }

    std::function<uint32_t()> getSerializedSizeProvider(void* data) override
    {
        return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
    }

    void* createData() override { return new Bytes(); }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, eprosima::fastrtps::rtps::InstanceHandle_t*, bool) override { return false; }
};

// Endpoints of other participants: topic, type and user data.
class Discovery : public DomainParticipantListener
{
public:
    std::mutex mutex;
    std::map<std::string, std::string> found;

    template<typename Info> void note(const Info& info)
    {
        const auto user = info.m_qos.m_userData.data_vec();
        std::lock_guard<std::mutex> lock(mutex);
        found[info.topicName().to_string()] =
            info.typeName().to_string() + " " + std::string(user.begin(), user.end());
    }

    void on_publisher_discovery(
        DomainParticipant*, eprosima::fastrtps::rtps::WriterDiscoveryInfo&& info) override { note(info.info); }
    void on_subscriber_discovery(
        DomainParticipant*, eprosima::fastrtps::rtps::ReaderDiscoveryInfo&& info) override { note(info.info); }
};

static std::string hex(const Bytes& bytes)
{
    static const char* digits = "0123456789abcdef";
    std::string text;
    for (uint8_t b : bytes) { text += digits[b >> 4]; text += digits[b & 15]; }
    return text;
}

static Bytes unhex(const std::string& text)
{
    Bytes bytes;
    for (size_t i = 0; i + 1 < text.size(); i += 2)
        bytes.push_back(static_cast<uint8_t>(std::stoi(text.substr(i, 2), nullptr, 16)));
    return bytes;
}

// sensor_msgs/JointState with one joint, by Fast CDR.
static Bytes joint_state(const std::string& name, double position)
{
    Bytes room(512);
    eprosima::fastcdr::FastBuffer buffer(reinterpret_cast<char*>(room.data()), room.size());
    eprosima::fastcdr::Cdr cdr(
        buffer, eprosima::fastcdr::Cdr::LITTLE_ENDIANNESS, eprosima::fastcdr::Cdr::DDS_CDR);
    cdr.serialize_encapsulation();
    cdr << int32_t(5) << uint32_t(6) << std::string("base");
    cdr << std::vector<std::string>{name} << std::vector<double>{position};
    cdr << std::vector<double>{} << std::vector<double>{};
    room.resize(cdr.getSerializedDataLength());
    return room;
}

int main(int argc, char** argv)
{
    DomainParticipantQos qos;
    if (argc > 2 && std::string(argv[2]) == "lo") {
        // As rmw_fastrtps (Jazzy) for LOCALHOST: no multicast, 32 participants of this machine are asked.
        auto& builtin = qos.wire_protocol().builtin;
        builtin.metatrafficMulticastLocatorList.clear();
        builtin.metatrafficUnicastLocatorList.push_back(eprosima::fastrtps::rtps::Locator_t());
        auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
        udp->maxInitialPeersRange = 32;
        qos.transport().use_builtin_transports = false;
        qos.transport().user_transports.push_back(
            std::make_shared<eprosima::fastdds::rtps::SharedMemTransportDescriptor>());
        qos.transport().user_transports.push_back(udp);
        eprosima::fastrtps::rtps::Locator_t peer;
        eprosima::fastrtps::rtps::IPLocator::setIPv4(peer, 127, 0, 0, 1);
        builtin.initialPeersList.push_back(peer);
    }
    const std::string enclave = "enclave=/;";
    qos.user_data().setValue(Bytes(enclave.begin(), enclave.end()));
    Discovery discovery;
    auto* participant = DomainParticipantFactory::get_instance()->create_participant(
        std::stoi(argv[1]), qos, &discovery, StatusMask::none());
    auto* publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    auto* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    std::map<std::string, Topic*> topics;
    std::map<std::string, DataWriter*> writers;
    std::map<std::string, DataReader*> readers;

    auto topic = [&](const std::string& name, const std::string& type) {
        if (!topics.count(name)) {
            TypeSupport(new RawType(type)).register_type(participant);
            topics[name] = participant->create_topic(name, type, TOPIC_QOS_DEFAULT);
        }
        return topics[name];
    };
    auto set = [](auto& q, bool reliable, bool latched) {
        q.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
        q.durability().kind = latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
        q.history().depth = 10;
        q.endpoint().history_memory_policy =
            eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;  // as rmw_fastrtps
    };

    std::cout << "ready" << std::endl;
    std::string line;
    while (std::getline(std::cin, line)) {
        std::istringstream words(line);
        std::string command, name, type, more;
        words >> command >> name >> type >> more;
        if (command == "advertise") {
            DataWriterQos q;
            set(q, true, more == "latched");
            writers[name] = publisher->create_datawriter(topic(name, type), q);
            std::cout << (writers[name] ? "ok" : "failed") << std::endl;
        } else if (command == "subscribe") {
            DataReaderQos q;
            set(q, more != "best_effort", more == "latched");
            readers[name] = subscriber->create_datareader(topic(name, type), q);
            std::cout << (readers[name] ? "ok" : "failed") << std::endl;
        } else if (command == "publish") {
            Bytes bytes = unhex(type);
            std::cout << writers[name]->write(&bytes) << std::endl;
        } else if (command == "joint_state") {
            Bytes bytes = joint_state(type, std::stod(more));
            std::cout << writers[name]->write(&bytes) << std::endl;
        } else if (command == "take") {
            Bytes bytes;
            SampleInfo info;
            std::string answer = "none";
            const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(std::stoi(type));
            while (answer == "none" && std::chrono::steady_clock::now() < end) {
                if (readers[name]->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
                    if (info.valid_data) answer = hex(bytes);
                } else {
                    std::this_thread::sleep_for(std::chrono::milliseconds(5));
                }
            }
            std::cout << answer << std::endl;
        } else if (command == "matched") {
            int count = 0;
            if (writers.count(name)) {
                PublicationMatchedStatus status;
                writers[name]->get_publication_matched_status(status);
                count = status.current_count;
            } else if (readers.count(name)) {
                SubscriptionMatchedStatus status;
                readers[name]->get_subscription_matched_status(status);
                count = status.current_count;
            }
            std::cout << count << std::endl;
        } else if (command == "found") {
            std::lock_guard<std::mutex> lock(discovery.mutex);
            const auto entry = discovery.found.find(name);
            std::cout << (entry == discovery.found.end() ? "none" : entry->second) << std::endl;
        } else {
            std::cout << "unknown command" << std::endl;
        }
    }
    participant->delete_contained_entities();
    DomainParticipantFactory::get_instance()->delete_participant(participant);
}
