// Unity's ROSConnection as the package uses it (ROS-TCP-Connector 0.7), over a real socket or, without one, to
// whoever runs the program. Framing, order and the two registrations as in the connector.
using System;
using System.Collections.Concurrent;
using System.Collections.Generic;
using System.IO;
using System.Net.Sockets;
using System.Text;
using System.Threading;
using Unity.Robotics.ROSTCPConnector.MessageGeneration;
using UnityEngine;

namespace Unity.Robotics.ROSTCPConnector
{
    public class RosTopicState { }

    public class ROSConnection : MonoBehaviour
    {
        class Subscription
        {
            public string type;
            public Func<MessageDeserializer, Message> read;
            public readonly List<Action<Message>> callbacks = new List<Action<Message>>();
        }

        static ROSConnection s_Instance;
        readonly Dictionary<string, string> m_Publishers = new Dictionary<string, string>();
        readonly Dictionary<string, Subscription> m_Subscriptions = new Dictionary<string, Subscription>();
        readonly Dictionary<string, bool> m_Latched = new Dictionary<string, bool>();
        readonly ConcurrentQueue<KeyValuePair<string, byte[]>> m_Incoming =
            new ConcurrentQueue<KeyValuePair<string, byte[]>>();
        readonly BlockingCollection<byte[]> m_Outgoing = new BlockingCollection<byte[]>();

        /// <summary>Told of every message when there is no socket: topic, type, bytes.</summary>
        public Action<string, string, byte[]> Sink;
        public volatile bool Closed;

        public static ROSConnection GetOrCreateInstance()
        {
            if (s_Instance == null) s_Instance = new GameObject("ROSConnection").AddComponent<ROSConnection>();
            return s_Instance;
        }

        public RosTopicState RegisterPublisher<T>(string rosTopicName, int? queue_size = null, bool? latch = null)
            where T : Message
        {
            m_Publishers[rosTopicName] = Type<T>();
            m_Latched[rosTopicName] = latch ?? false;
            Announce(rosTopicName);
            return new RosTopicState();
        }

        public void Subscribe<T>(string topic, Action<T> callback) where T : Message
        {
            Subscription subscription;
            if (!m_Subscriptions.TryGetValue(topic, out subscription))
            {
                subscription = new Subscription { type = Type<T>(), read = MessageRegistry.Get(Type<T>() + ":Default") };
                m_Subscriptions.Add(topic, subscription);
            }
            subscription.callbacks.Add(message => callback((T)message));
            Command("__subscribe", Topic(topic, subscription.type));
        }

        public void Publish(string rosTopicName, Message message)
        {
            string type;
            if (!m_Publishers.TryGetValue(rosTopicName, out type))
                throw new InvalidOperationException(rosTopicName + " is not registered for publishing");
            if (type != message.RosMessageName) throw new InvalidOperationException("wrong type on " + rosTopicName);
            MessageSerializer serializer = new MessageSerializer();
            message.SerializeTo(serializer);
            if (Sink != null) Sink(rosTopicName, type, serializer.GetBytes());
            else Frame(rosTopicName, serializer.GetBytes());
        }

        /// <summary>Hand over what came, as the connector does in its Update.</summary>
        public void Update()
        {
            KeyValuePair<string, byte[]> item;
            while (m_Incoming.TryDequeue(out item)) Receive(item.Key, item.Value);
        }

        public void Receive(string topic, byte[] body)
        {
            Subscription subscription;
            if (!m_Subscriptions.TryGetValue(topic, out subscription)) return;
            Message message = subscription.read(new MessageDeserializer(body));
            foreach (Action<Message> callback in subscription.callbacks) callback(message);
        }

        static string Type<T>()
        {
            return (string)typeof(T).GetField("k_RosMessageName").GetValue(null);
        }

        // --- the wire ---
        public void Connect(string host, int port)
        {
            TcpClient client = new TcpClient(host, port);
            NetworkStream stream = client.GetStream();
            new Thread(() => Write(stream)) { IsBackground = true }.Start();
            new Thread(() => Read(stream)) { IsBackground = true }.Start();
            m_Outgoing.Add(new byte[8]); // keep-alive
            foreach (KeyValuePair<string, Subscription> item in m_Subscriptions)
                Command("__subscribe", Topic(item.Key, item.Value.type));
            foreach (string topic in m_Publishers.Keys) Announce(topic);
            Command("__topic_list", "{}");
        }

        void Announce(string topic)
        {
            Command("__publish", "{\"topic\":\"" + topic + "\",\"message_name\":\"" + m_Publishers[topic]
                + "\",\"queue_size\":10,\"latch\":" + (m_Latched[topic] ? "true" : "false") + "}");
        }

        static string Topic(string topic, string type)
        {
            return "{\"topic\":\"" + topic + "\",\"message_name\":\"" + type + "\"}";
        }

        void Command(string name, string json)
        {
#if ROS2
            json += "\0";
#endif
            if (Sink == null) Frame(name, Encoding.UTF8.GetBytes(json));
        }

        void Frame(string name, byte[] body)
        {
#if ROS2
            name += "\0";
#endif
            byte[] head = Encoding.UTF8.GetBytes(name);
            MemoryStream all = new MemoryStream();
            all.Write(BitConverter.GetBytes(head.Length), 0, 4);
            all.Write(head, 0, head.Length);
            all.Write(BitConverter.GetBytes(body.Length), 0, 4);
            all.Write(body, 0, body.Length);
            m_Outgoing.Add(all.ToArray());
        }

        void Write(NetworkStream stream)
        {
            try
            {
                foreach (byte[] frame in m_Outgoing.GetConsumingEnumerable()) stream.Write(frame, 0, frame.Length);
            }
            catch (IOException)
            {
                Closed = true;
            }
        }

        void Read(NetworkStream stream)
        {
            try
            {
                BinaryReader reader = new BinaryReader(stream);
                while (true)
                {
                    string name = Encoding.ASCII.GetString(reader.ReadBytes(reader.ReadInt32()));
                    byte[] body = reader.ReadBytes(reader.ReadInt32());
                    if (!name.StartsWith("__")) m_Incoming.Enqueue(new KeyValuePair<string, byte[]>(name, body));
                    else if (name != "__topic_list") Console.Error.WriteLine(name + " " + Encoding.UTF8.GetString(body));
                }
            }
            catch (IOException)
            {
                Closed = true;
            }
        }
    }
}
