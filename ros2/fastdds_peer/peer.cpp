// SPDX-License-Identifier: Apache-2.0
// A peer of `cm bridge dds` on eProsima Fast DDS: another implementation of DDS, in another language, with no code of
// the bridge's. Types are written out by hand, so that nothing but the library is needed:
//   peer DOMAIN picture TOPIC FILE COUNT   waits for COUNT pictures and writes the last as PGM or PPM
//   peer DOMAIN status TOPIC               prints the first status that comes (it was published before we came)
//   peer DOMAIN relay FROM TO COUNT        publishes what comes on FROM on TO, and says for how many
// With CM_PEER_LOOPBACK=1 it keeps to this machine's loopback.
#include <atomic>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iostream>
#include <mutex>
#include <string>
#include <vector>

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

namespace fast = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;

namespace {

constexpr uint32_t LARGEST = 64u << 20;  // bytes of a picture that is taken
constexpr int BUFFER = 4 << 20;          // of sockets: less loses pictures

struct Header {
    int32_t sec = 0;
    uint32_t nanosec = 0;
    std::string frame_id;
};

struct Image {
    Header header;
    uint32_t height = 0, width = 0;
    std::string encoding;
    uint8_t is_bigendian = 0;
    uint32_t step = 0;
    std::vector<uint8_t> data;
};

struct Status {  // the fields that are printed, and what stands before them
    Header header;
    std::string board, config_name, mode;
};

void get(Cdr& cdr, Header& h) { cdr >> h.sec >> h.nanosec >> h.frame_id; }
void put(Cdr& cdr, const Header& h) { cdr << h.sec << h.nanosec << h.frame_id; }

void get(Cdr& cdr, Image& i)
{
    get(cdr, i.header);
    cdr >> i.height >> i.width >> i.encoding >> i.is_bigendian >> i.step >> i.data;
}

void put(Cdr& cdr, const Image& i)
{
    put(cdr, i.header);
    cdr << i.height << i.width << i.encoding << i.is_bigendian << i.step << i.data;
}

void get(Cdr& cdr, Status& s)
{
    get(cdr, s.header);
    cdr >> s.board >> s.config_name >> s.mode;
}

void put(Cdr&, const Status&) {}  // never published here

template <class T> class Type : public fast::TopicDataType {
public:
    explicit Type(const char* name)
    {
        setName(name);
        m_typeSize = LARGEST;
        m_isGetKeyDefined = false;
    }
    bool serialize(void* data, rtps::SerializedPayload_t* payload) override
    {
        FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->max_size);
        Cdr cdr(buffer, Cdr::LITTLE_ENDIANNESS, Cdr::DDS_CDR);
        payload->encapsulation = CDR_LE;
        cdr.serialize_encapsulation();
        put(cdr, *static_cast<T*>(data));
        payload->length = static_cast<uint32_t>(cdr.getSerializedDataLength());
        return true;
    }
    bool deserialize(rtps::SerializedPayload_t* payload, void* data) override
    {
        try {
            FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->length);
            Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
            cdr.read_encapsulation();
            get(cdr, *static_cast<T*>(data));
            return true;
        } catch (const std::exception& error) {
            std::cerr << "peer: not a " << getName() << ": " << error.what() << std::endl;
            return false;
        }
    }
    std::function<uint32_t()> getSerializedSizeProvider(void* data) override { return [this, data] { return size(data); }; }
    void* createData() override { return new T(); }
    void deleteData(void* data) override { delete static_cast<T*>(data); }
    bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }

private:
    uint32_t size(void* data) const;
};

template <> uint32_t Type<Image>::size(void* data) const
{
    const auto* image = static_cast<Image*>(data);
    return static_cast<uint32_t>(64 + image->header.frame_id.size() + image->encoding.size() + image->data.size());
}
template <> uint32_t Type<Status>::size(void*) const { return 4; }

// What comes, one at a time, to the main thread.
template <class T> class Inbox : public fast::DataReaderListener {
public:
    void on_data_available(fast::DataReader* reader) override
    {
        T value;
        fast::SampleInfo info;
        while (reader->take_next_sample(&value, &info) == eprosima::fastrtps::types::ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) continue;
            std::lock_guard<std::mutex> guard(lock_);
            latest_ = std::move(value);
            ++count_;
            came_.notify_one();
        }
    }
    unsigned await(unsigned more_than, T& value)
    {
        std::unique_lock<std::mutex> guard(lock_);
        if (!came_.wait_for(guard, std::chrono::seconds(60), [&] { return count_ > more_than; })) {
            std::cerr << "peer: nothing came within 60 s" << std::endl;
            std::_Exit(1);
        }
        value = latest_;
        return count_;
    }

private:
    std::mutex lock_;
    std::condition_variable came_;
    T latest_;
    unsigned count_ = 0;
};

fast::DomainParticipant* participant(uint32_t domain)
{
    fast::DomainParticipantQos qos;
    qos.name("fastdds_peer");
    auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->receiveBufferSize = BUFFER;
    qos.transport().use_builtin_transports = false;
    if (std::getenv("CM_PEER_LOOPBACK")) {
        udp->interfaceWhiteList.push_back("127.0.0.1");
        udp->maxInitialPeersRange = 20;
        rtps::Locator_t here;
        here.kind = LOCATOR_KIND_UDPv4;
        eprosima::fastrtps::rtps::IPLocator::setIPv4(here, "127.0.0.1");
        qos.wire_protocol().builtin.initialPeersList.push_back(here);
    }
    qos.transport().user_transports.push_back(udp);
    auto* made = fast::DomainParticipantFactory::get_instance()->create_participant(domain, qos);
    if (!made) std::exit(1);
    return made;
}

template <class T>
fast::DataReader* reader(fast::DomainParticipant* p, const std::string& name, const char* type, Inbox<T>& inbox, bool latched)
{
    fast::TypeSupport support(new Type<T>(type));
    support.register_type(p);
    auto* topic = p->create_topic(name, type, fast::TOPIC_QOS_DEFAULT);
    fast::DataReaderQos qos;
    qos.endpoint().history_memory_policy = rtps::DYNAMIC_RESERVE_MEMORY_MODE;
    qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
    if (latched) qos.durability().kind = fast::TRANSIENT_LOCAL_DURABILITY_QOS;
    qos.history().depth = 2;
    return p->create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic, qos, &inbox);
}

fast::DataWriter* writer(fast::DomainParticipant* p, const std::string& name, const char* type)
{
    auto* topic = p->create_topic(name, type, fast::TOPIC_QOS_DEFAULT);
    fast::DataWriterQos qos;
    qos.endpoint().history_memory_policy = rtps::DYNAMIC_RESERVE_MEMORY_MODE;
    qos.history().depth = 2;
    qos.publish_mode().kind = fast::ASYNCHRONOUS_PUBLISH_MODE;
    return p->create_publisher(fast::PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, qos);
}

bool save(const Image& image, const std::string& path)
{
    const bool colour = image.encoding == "rgb8";
    if (!colour && image.encoding != "mono8") {
        std::cerr << "peer: pictures of " << image.encoding << " are not written" << std::endl;
        return false;
    }
    const size_t row = image.width * (colour ? 3u : 1u);
    if (image.step < row || image.data.size() < size_t(image.step) * image.height) return false;
    std::ofstream out(path, std::ios::binary);
    out << (colour ? "P6" : "P5") << "\n" << image.width << " " << image.height << "\n255\n";
    for (uint32_t y = 0; y < image.height; ++y)
        out.write(reinterpret_cast<const char*>(image.data.data()) + size_t(y) * image.step, std::streamsize(row));
    return bool(out);
}

constexpr const char* IMAGE = "sensor_msgs::msg::dds_::Image_";
constexpr const char* STATUS = "cm_interfaces::msg::dds_::Status_";

int picture(fast::DomainParticipant* p, const std::string& topic, const std::string& file, unsigned wanted)
{
    Inbox<Image> inbox;
    auto* from = reader(p, topic, IMAGE, inbox, false);
    Image image;
    unsigned count = 0;
    while (count < wanted) count = inbox.await(count, image);
    from->set_listener(nullptr);
    std::cout << image.width << "x" << image.height << " " << image.encoding << " " << image.header.frame_id << " "
              << count << std::endl;
    return save(image, file) ? 0 : 1;
}

int status(fast::DomainParticipant* p, const std::string& topic)
{
    Inbox<Status> inbox;
    auto* from = reader(p, topic, STATUS, inbox, true);
    Status first;
    inbox.await(0, first);
    from->set_listener(nullptr);
    std::cout << first.board << " " << first.config_name << "/" << first.mode << std::endl;
    return 0;
}

int relay(fast::DomainParticipant* p, const std::string& from, const std::string& to, unsigned wanted)
{
    Inbox<Image> inbox;
    auto* source = reader(p, from, IMAGE, inbox, false);
    auto* sink = writer(p, to, IMAGE);
    Image image;
    unsigned seen = 0, sent = 0;
    while (sent < wanted) {
        seen = inbox.await(seen, image);
        if (sink->write(&image)) ++sent;
    }
    sink->wait_for_acknowledgments(eprosima::fastrtps::Duration_t(10, 0));
    source->set_listener(nullptr);
    std::cout << sent << std::endl;
    return 0;
}

}  // namespace

int main(int argc, char** argv)
{
    const std::vector<std::string> words(argv + 1, argv + argc);
    if (words.size() < 3) {
        std::cerr << "usage: peer DOMAIN picture TOPIC FILE COUNT | status TOPIC | relay FROM TO COUNT" << std::endl;
        return 2;
    }
    auto* p = participant(static_cast<uint32_t>(std::stoul(words[0])));
    int result = 2;
    if (words[1] == "picture" && words.size() == 5)
        result = picture(p, "rt" + words[2], words[3], static_cast<unsigned>(std::stoul(words[4])));
    else if (words[1] == "status")
        result = status(p, "rt" + words[2]);
    else if (words[1] == "relay" && words.size() == 5)
        result = relay(p, "rt" + words[2], "rt" + words[3], static_cast<unsigned>(std::stoul(words[4])));
    std::_Exit(result);  // threads of the library may still be at work
}
