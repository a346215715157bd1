from training.cmu import Trial, index_url, read_index

PAGE = """<HTML><BODY>
<TABLE><TR><TD><A HREF="/">Home</A> | <A HREF="search.php">Search</A></TABLE>
<TABLE BORDER=1>
<TR><TD COLSPAN=3>Subject #2 (various expressions and human behaviors)
  <A HREF="search.php?subjectnumber=2&amp;subtext=yes">file index</A></TD>
  <TD><A HREF="/subjects/02/02.asf">asf</A></TD></TR>
<TR><TH>Image<TH>Trial #<TH>Motion Description<TH>tvd<TH>c3d<TH>amc<TH>mpg<TH>Framerate</TR>
<TR><TD><IMG SRC="/thumb/02_01.jpg"></TD><TD>1</TD><TD>walk</TD>
  <TD><A HREF="/subjects/02/02_01.tvd">tvd</A></TD><TD><A HREF="/subjects/02/02_01.c3d">c3d</A></TD>
  <TD><A HREF="/subjects/02/02_01.amc">amc</A></TD><TD></TD><TD>120</TD></TR>
<tr><td>&nbsp;<td> 2 <td>bend over,
   scoop up &amp; <b>rise</b><td><a href='subjects/02/02_02.C3D'>c3d</a><td>120
<tr><td>&nbsp;<td>3<td><td><a href="http://mirror.test/subjects/02/02_03.c3d">c3d</a><td>120
<tr><td>&nbsp;<td>4<td>has no C3D file<td><a href="subjects/02/02_04.amc">amc</a><td>120
<tr><td>&nbsp;<td>1<td>of another subject<td><a href="subjects/12/12_01.c3d">c3d</a><td>120
</TABLE></BODY></HTML>
"""


def test_the_index_names_the_trials_of_a_subject():
    assert read_index(PAGE, "02") == [
        Trial("02", "01", "walk"),
        Trial("02", "02", "bend over, scoop up & rise"),
        Trial("02", "03", ""),
    ]
    assert read_index(PAGE, "12") == [Trial("12", "01", "of another subject")]


def test_what_is_no_index_names_none():
    for page in ("", "02_01.c3d", "<p>Sorry, no results</p>", "<table><tr><td>", "\0<a <td"):
        assert read_index(page, "02") == []
    assert read_index(PAGE, "2") == []


def test_a_cut_index_names_what_came():
    assert [trial.number for trial in read_index(PAGE[: PAGE.index("http://mirror")], "02")] == [
        "01",
        "02",
    ]


def test_addresses():
    assert index_url("http://cmu.test", "02") == "http://cmu.test/search.php?subjectnumber=2"
    assert index_url("http://cmu.test", "135") == "http://cmu.test/search.php?subjectnumber=135"
    assert Trial("135", "02", "").file == "135/135_02.c3d"
