// What generated classes use of Unity's ROS-TCP-Connector 0.7, written anew so that they can be compiled and
// run without Unity. Wire behaviour as in the connector: ROS 1, and with -define:ROS2 little-endian CDR.
using System;
using System.Collections.Generic;
using System.IO;
using System.Text;

namespace UnityEngine
{
    public class RuntimeInitializeOnLoadMethodAttribute : Attribute { }
}

namespace Unity.Robotics.ROSTCPConnector.MessageGeneration
{
    public enum MessageSubtopic { Default, Response, Goal, Feedback, Result }

    public abstract class Message
    {
        public abstract string RosMessageName { get; }
        public virtual void SerializeTo(MessageSerializer serializer) { }
    }

    public static class MessageRegistry
    {
        static readonly Dictionary<string, Func<MessageDeserializer, Message>> s_Known =
            new Dictionary<string, Func<MessageDeserializer, Message>>();

        public static void Register<T>(string name, Func<MessageDeserializer, T> make,
            MessageSubtopic subtopic = MessageSubtopic.Default) where T : Message
        {
            s_Known.Add(name + ":" + subtopic, d => make(d));
        }

        public static Func<MessageDeserializer, Message> Get(string key) => s_Known[key];
    }

    public class MessageSerializer
    {
        readonly MemoryStream m_Out = new MemoryStream();

        public byte[] GetBytes()
        {
#if ROS2
            byte[] body = m_Out.ToArray();
            byte[] all = new byte[body.Length + 4];
            all[1] = 1;
            body.CopyTo(all, 4);
            return all;
#else
            return m_Out.ToArray();
#endif
        }

        void Put(byte[] bytes, int align)
        {
#if ROS2
            while (m_Out.Position % align != 0) m_Out.WriteByte(0);
#endif
            m_Out.Write(bytes, 0, bytes.Length);
        }

        public void Write(Message m) { m.SerializeTo(this); }
        public void Write(bool v) { Put(BitConverter.GetBytes(v), 1); }
        public void Write(byte v) { Put(new byte[] { v }, 1); }
        public void Write(sbyte v) { Put(new byte[] { (byte)v }, 1); }
        public void Write(short v) { Put(BitConverter.GetBytes(v), 2); }
        public void Write(ushort v) { Put(BitConverter.GetBytes(v), 2); }
        public void Write(int v) { Put(BitConverter.GetBytes(v), 4); }
        public void Write(uint v) { Put(BitConverter.GetBytes(v), 4); }
        public void Write(long v) { Put(BitConverter.GetBytes(v), 8); }
        public void Write(ulong v) { Put(BitConverter.GetBytes(v), 8); }
        public void Write(float v) { Put(BitConverter.GetBytes(v), 4); }
        public void Write(double v) { Put(BitConverter.GetBytes(v), 8); }
        public void WriteLength<T>(T[] values) { Write(values.Length); }
        public void Write<T>(T[] values) where T : Message { foreach (T v in values) v.SerializeTo(this); }
        public void Write(bool[] values) { foreach (bool v in values) Write(v); }
        public void Write(byte[] values) { foreach (byte v in values) Write(v); }
        public void Write(sbyte[] values) { foreach (sbyte v in values) Write(v); }
        public void Write(short[] values) { foreach (short v in values) Write(v); }
        public void Write(ushort[] values) { foreach (ushort v in values) Write(v); }
        public void Write(int[] values) { foreach (int v in values) Write(v); }
        public void Write(uint[] values) { foreach (uint v in values) Write(v); }
        public void Write(long[] values) { foreach (long v in values) Write(v); }
        public void Write(ulong[] values) { foreach (ulong v in values) Write(v); }
        public void Write(float[] values) { foreach (float v in values) Write(v); }
        public void Write(double[] values) { foreach (double v in values) Write(v); }
        public void Write(string[] values) { foreach (string v in values) Write(v); }
        public void Write(string v)
        {
            byte[] text = Encoding.UTF8.GetBytes(v);
#if ROS2
            Write(text.Length + 1);
            Put(text, 1);
            Put(new byte[] { 0 }, 1);
#else
            Write(text.Length);
            Put(text, 1);
#endif
        }
    }

    public class MessageDeserializer
    {
        readonly byte[] m_Data;
        int m_At;
#if ROS2
        const int k_Start = 4;
#else
        const int k_Start = 0;
#endif

        public MessageDeserializer(byte[] data)
        {
            m_Data = data;
            m_At = k_Start;
        }

        public int Left => m_Data.Length - m_At;

        int Take(int size)
        {
#if ROS2
            while ((m_At - k_Start) % size != 0) m_At++;
#endif
            m_At += size;
            return m_At - size;
        }

        public int ReadLength() => BitConverter.ToInt32(m_Data, Take(4));
        public void Read(out bool v) { v = m_Data[Take(1)] != 0; }
        public void Read(out byte v) { v = m_Data[Take(1)]; }
        public void Read(out sbyte v) { v = (sbyte)m_Data[Take(1)]; }
        public void Read(out short v) { v = BitConverter.ToInt16(m_Data, Take(2)); }
        public void Read(out ushort v) { v = BitConverter.ToUInt16(m_Data, Take(2)); }
        public void Read(out int v) { v = BitConverter.ToInt32(m_Data, Take(4)); }
        public void Read(out uint v) { v = BitConverter.ToUInt32(m_Data, Take(4)); }
        public void Read(out long v) { v = BitConverter.ToInt64(m_Data, Take(8)); }
        public void Read(out ulong v) { v = BitConverter.ToUInt64(m_Data, Take(8)); }
        public void Read(out float v) { v = BitConverter.ToSingle(m_Data, Take(4)); }
        public void Read(out double v) { v = BitConverter.ToDouble(m_Data, Take(8)); }
        public void Read(out string v)
        {
            int length = ReadLength();
            int at = m_At;
            m_At += length;
#if ROS2
            length -= 1;
#endif
            v = Encoding.UTF8.GetString(m_Data, at, length);
        }
        public void Read<T>(out T[] values, int elementSize, int length)
        {
            values = new T[length];
            if (length == 0) return;
            Take(elementSize);
            m_At -= elementSize;
            Buffer.BlockCopy(m_Data, m_At, values, 0, length * elementSize);
            m_At += length * elementSize;
        }
        public void Read<T>(out T[] values, Func<MessageDeserializer, Message> make, int length) where T : Message
        {
            values = new T[length];
            for (int i = 0; i < length; i++) values[i] = (T)make(this);
        }
        public void Read(out string[] values, int length)
        {
            values = new string[length];
            for (int i = 0; i < length; i++) Read(out values[i]);
        }
    }
}

namespace RosMessageTypes.BuiltinInterfaces
{
    using Unity.Robotics.ROSTCPConnector.MessageGeneration;

    public class TimeMsg : Message
    {
        public override string RosMessageName => "time";
#if ROS2
        public int sec;
#else
        public uint sec;
#endif
        public uint nanosec;
        public static TimeMsg Deserialize(MessageDeserializer d)
        {
            TimeMsg m = new TimeMsg();
            d.Read(out m.sec);
            d.Read(out m.nanosec);
            return m;
        }
        public override void SerializeTo(MessageSerializer s) { s.Write(sec); s.Write(nanosec); }
    }

    public class DurationMsg : Message
    {
        public override string RosMessageName => "duration";
        public int sec;
#if ROS2
        public uint nanosec;
#else
        public int nanosec;
#endif
        public static DurationMsg Deserialize(MessageDeserializer d)
        {
            DurationMsg m = new DurationMsg();
            d.Read(out m.sec);
            d.Read(out m.nanosec);
            return m;
        }
        public override void SerializeTo(MessageSerializer s) { s.Write(sec); s.Write(nanosec); }
    }
}

namespace RosMessageTypes.Std
{
    using RosMessageTypes.BuiltinInterfaces;
    using Unity.Robotics.ROSTCPConnector.MessageGeneration;

    public class HeaderMsg : Message
    {
        public override string RosMessageName => "std_msgs/Header";
        public uint seq;
        public TimeMsg stamp = new TimeMsg();
        public string frame_id = "";
        public static HeaderMsg Deserialize(MessageDeserializer d)
        {
            HeaderMsg m = new HeaderMsg();
#if !ROS2
            d.Read(out m.seq);
#endif
            m.stamp = TimeMsg.Deserialize(d);
            d.Read(out m.frame_id);
            return m;
        }
        public override void SerializeTo(MessageSerializer s)
        {
#if !ROS2
            s.Write(seq);
#endif
            s.Write(stamp);
            s.Write(frame_id);
        }
    }
}

public static class Echo
{
    // Reads "key hex" lines, writes the hex of the message read and written again by the generated class.
    public static void Main()
    {
        foreach (Type type in typeof(Echo).Assembly.GetTypes())
        {
            System.Reflection.MethodInfo register = type.GetMethod("Register", Type.EmptyTypes);
            if (register != null) register.Invoke(null, null);
        }
        string line;
        while ((line = Console.ReadLine()) != null)
        {
            string[] parts = line.Split(' ');
            byte[] data = new byte[parts[1].Length / 2];
            for (int i = 0; i < data.Length; i++) data[i] = Convert.ToByte(parts[1].Substring(2 * i, 2), 16);
            MessageDeserializer from = new MessageDeserializer(data);
            Unity.Robotics.ROSTCPConnector.MessageGeneration.Message message =
                Unity.Robotics.ROSTCPConnector.MessageGeneration.MessageRegistry.Get(parts[0])(from);
            MessageSerializer to = new MessageSerializer();
            message.SerializeTo(to);
            message.ToString();
            Console.WriteLine(from.Left + " " + BitConverter.ToString(to.GetBytes()).Replace("-", ""));
        }
    }

    class MessageDeserializer : Unity.Robotics.ROSTCPConnector.MessageGeneration.MessageDeserializer
    {
        public MessageDeserializer(byte[] data) : base(data) { }
    }

    class MessageSerializer : Unity.Robotics.ROSTCPConnector.MessageGeneration.MessageSerializer { }
}
