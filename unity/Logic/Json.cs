using System;
using System.Collections.Generic;
using System.Globalization;
using System.Text;

namespace Armcell.Logic
{
    /// <summary>A value of a JSON file, with its place, so that a wrong one is told by name.</summary>
    public class Json
    {
        readonly object m_Value; // Dictionary, List, string, double, bool or null
        readonly string m_Place;

        Json(object value, string place)
        {
            m_Value = value;
            m_Place = place;
        }

        public static Json Parse(string text)
        {
            Parser parser = new Parser(text);
            object value = parser.Value(0);
            parser.End();
            return new Json(value, "");
        }

        public bool Has(string key)
        {
            return Object().ContainsKey(key);
        }

        public Json this[string key]
        {
            get
            {
                object value;
                if (Object().TryGetValue(key, out value)) return new Json(value, m_Place + "/" + key);
                throw Wrong("has no '" + key + "'");
            }
        }

        public IEnumerable<KeyValuePair<string, Json>> Members
        {
            get
            {
                foreach (KeyValuePair<string, object> item in Object())
                    yield return new KeyValuePair<string, Json>(item.Key, new Json(item.Value, m_Place + "/" + item.Key));
            }
        }

        public List<Json> Items
        {
            get
            {
                List<object> list = m_Value as List<object>;
                if (list == null) throw Wrong("is not a list");
                List<Json> items = new List<Json>();
                for (int i = 0; i < list.Count; i++) items.Add(new Json(list[i], m_Place + "/" + i));
                return items;
            }
        }

        public double Number
        {
            get
            {
                if (m_Value is double) return (double)m_Value;
                throw Wrong("is not a number");
            }
        }

        public string Text
        {
            get
            {
                string text = m_Value as string;
                if (text == null) throw Wrong("is not a text");
                return text;
            }
        }

        public bool Truth
        {
            get
            {
                if (m_Value is bool) return (bool)m_Value;
                throw Wrong("is not true or false");
            }
        }

        /// <summary>A list of so many numbers.</summary>
        public double[] Numbers(int count)
        {
            List<Json> items = Items;
            if (items.Count != count) throw Wrong("has " + items.Count + " numbers, not " + count);
            return items.ConvertAll(i => i.Number).ToArray();
        }

        public double NumberOr(string key, double otherwise)
        {
            return Has(key) ? this[key].Number : otherwise;
        }

        Dictionary<string, object> Object()
        {
            Dictionary<string, object> value = m_Value as Dictionary<string, object>;
            if (value == null) throw Wrong("is not an object");
            return value;
        }

        FormatException Wrong(string what)
        {
            return new FormatException((m_Place == "" ? "the file" : m_Place) + " " + what);
        }

        class Parser
        {
            const int k_MaxDepth = 64;
            readonly string m_Text;
            int m_At;

            public Parser(string text)
            {
                m_Text = text;
            }

            public object Value(int depth)
            {
                if (depth > k_MaxDepth) throw Wrong("is nested too deeply");
                switch (Next())
                {
                    case '{': return Members(depth);
                    case '[': return List(depth);
                    case '"': return String();
                    case 't': return Word("true", true);
                    case 'f': return Word("false", false);
                    case 'n': return Word("null", null);
                    default: return Number();
                }
            }

            public void End()
            {
                Skip();
                if (m_At < m_Text.Length) throw Wrong("goes on after its end");
            }

            Dictionary<string, object> Members(int depth)
            {
                Dictionary<string, object> found = new Dictionary<string, object>();
                m_At++;
                if (Next() == '}')
                {
                    m_At++;
                    return found;
                }
                while (true)
                {
                    if (Next() != '"') throw Wrong("needs a name");
                    string key = String();
                    if (Next() != ':') throw Wrong("needs ':'");
                    m_At++;
                    if (found.ContainsKey(key)) throw Wrong("has '" + key + "' twice");
                    found.Add(key, Value(depth + 1));
                    char end = Next();
                    if (end != ',' && end != '}') throw Wrong("needs ',' or '}'");
                    m_At++;
                    if (end == '}') return found;
                }
            }

            List<object> List(int depth)
            {
                List<object> found = new List<object>();
                m_At++;
                if (Next() == ']')
                {
                    m_At++;
                    return found;
                }
                while (true)
                {
                    found.Add(Value(depth + 1));
                    char end = Next();
                    if (end != ',' && end != ']') throw Wrong("needs ',' or ']'");
                    m_At++;
                    if (end == ']') return found;
                }
            }

            string String()
            {
                StringBuilder found = new StringBuilder();
                for (m_At++; m_At < m_Text.Length; m_At++)
                {
                    char c = m_Text[m_At];
                    if (c == '"')
                    {
                        m_At++;
                        return found.ToString();
                    }
                    if (c != '\\')
                    {
                        found.Append(c);
                        continue;
                    }
                    if (++m_At >= m_Text.Length) break;
                    int known = "\"\\/bfnrt".IndexOf(m_Text[m_At]);
                    if (known >= 0) found.Append("\"\\/\b\f\n\r\t"[known]);
                    else if (m_Text[m_At] == 'u' && m_At + 4 < m_Text.Length)
                    {
                        int code;
                        if (!int.TryParse(m_Text.Substring(m_At + 1, 4), NumberStyles.HexNumber,
                            CultureInfo.InvariantCulture, out code)) throw Wrong("has a bad \\u");
                        found.Append((char)code);
                        m_At += 4;
                    }
                    else throw Wrong("has an unknown escape");
                }
                throw Wrong("ends within a text");
            }

            object Word(string word, object value)
            {
                if (string.CompareOrdinal(m_Text, m_At, word, 0, word.Length) != 0) throw Wrong("has an unknown word");
                m_At += word.Length;
                return value;
            }

            object Number()
            {
                int start = m_At;
                while (m_At < m_Text.Length && "+-.0123456789eE".IndexOf(m_Text[m_At]) >= 0) m_At++;
                double value;
                if (!double.TryParse(m_Text.Substring(start, m_At - start), NumberStyles.Float,
                    CultureInfo.InvariantCulture, out value)) throw Wrong("has something that is no value");
                return value;
            }

            char Next()
            {
                Skip();
                if (m_At >= m_Text.Length) throw Wrong("ends too early");
                return m_Text[m_At];
            }

            void Skip()
            {
                while (m_At < m_Text.Length && char.IsWhiteSpace(m_Text[m_At])) m_At++;
            }

            FormatException Wrong(string what)
            {
                int line = 1;
                for (int i = 0; i < m_At && i < m_Text.Length; i++) if (m_Text[i] == '\n') line++;
                return new FormatException("JSON, line " + line + ": it " + what);
            }
        }
    }
}
